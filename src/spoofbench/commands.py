"""Commands that other distributions bring to the command line.

The entry point of a command, group ``spoofbench.commands``, is a function with typer's annotations;
its name is the command's. ``spoofbench --help`` names it without importing it, and what is wrong
with it stops this one command alone. Entry points are looked for only where a command is not one of
spoofbench's own.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand, TyperGroup

from spoofbench.errors import PluginError
from spoofbench.terminal import complain

if TYPE_CHECKING:
    from spoofbench.plugins import Plugin


class PluginCommand(TyperCommand):
    """A command by name and distribution; the command itself is imported when it is used."""

    def __init__(self, plugin: "Plugin") -> None:
        super().__init__(plugin.name, help=f"Of {plugin.distribution}; ask it with --help.")
        self.plugin = plugin

    def load(self) -> Any:
        """Import the function and return its command.

        Raises:
            PluginError: the import failed, or typer makes no command of what was imported.
        """
        function = self.plugin.load()
        app = typer.Typer(
            add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
        )
        try:
            app.command(self.plugin.name)(function)
            return typer.main.get_command(app)
        except Exception as error:  # a plugin may bring anything
            raise PluginError(
                f"{self.plugin} is not a function with typer's annotations: "
                f"{type(error).__name__}: {error}"
            ) from error


class CommandGroup(TyperGroup):
    """The commands of spoofbench, then those of other distributions."""

    def list_commands(self, ctx: Any) -> list[str]:
        for name, plugin in self._add_plugins().items():
            if not isinstance(self.commands[name], PluginCommand):
                complain(f"{plugin} is ignored: spoofbench has a command {name!r} itself")
        return super().list_commands(ctx)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self.commands:
            self._add_plugins()
        return super().get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        name, command, rest = super().resolve_command(ctx, args)
        return name, command.load() if isinstance(command, PluginCommand) else command, rest

    def _add_plugins(self) -> Mapping[str, "Plugin"]:
        from spoofbench import plugins

        try:
            found = plugins.found(plugins.COMMANDS)
        except PluginError as error:
            complain(str(error))
            return {}
        for name, plugin in found.items():
            self.commands.setdefault(name, PluginCommand(plugin))
        return found
