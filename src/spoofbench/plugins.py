"""Plugins: found without import, loaded when used, blamed by name.

Converters, attacks, detectors and commands of any distribution, ours included, come in by the
same entry-point groups.
"""

from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any, Literal

from spoofbench import config
from spoofbench.errors import PluginError

Group = Literal[
    "spoofbench.converters",
    "spoofbench.attacks",
    "spoofbench.detectors",
    "spoofbench.commands",
]
CONVERTERS: Group = "spoofbench.converters"
ATTACKS: Group = "spoofbench.attacks"
DETECTORS: Group = "spoofbench.detectors"
COMMANDS: Group = "spoofbench.commands"


def role(group: Group) -> str:
    """Return what a plugin of the group is: ``converter``, ``attack``, ``detector`` or
    ``command``.
    """
    return group.removeprefix("spoofbench.").removesuffix("s")


@dataclass(frozen=True, slots=True)
class Plugin:
    """An entry point that is installed but not imported."""

    group: Group
    name: str
    distribution: str
    version: str
    entry_point: EntryPoint

    def __str__(self) -> str:
        return f"{role(self.group)} {self.name!r} of {self.distribution} {self.version}"

    def load(self) -> Any:
        """Import the plugin and return its object.

        Raises:
            PluginError: the import failed; names the plugin, its distribution and the reason.
        """
        try:
            return self.entry_point.load()
        except Exception as error:  # a plugin may raise anything
            raise PluginError(
                f"{self} cannot be loaded from {self.entry_point.value!r}: "
                f"{type(error).__name__}: {error}; "
                f"reinstall or remove the distribution {self.distribution!r}"
            ) from error


@cache
def found(group: Group) -> Mapping[str, Plugin]:
    """Return the plugins of a group by name, without importing any.

    Raises:
        PluginError: two distributions claim one name.
    """
    plugins: dict[str, Plugin] = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        distribution = entry.dist
        name, version = (
            (distribution.name, distribution.version)
            if distribution
            else ("an unknown distribution", "?")
        )
        plugin = Plugin(group, entry.name, name, version, entry)
        other = plugins.setdefault(entry.name, plugin)
        if (other.distribution, other.entry_point.value) != (plugin.distribution, entry.value):
            raise PluginError(
                f"{other} and {plugin} claim one name; uninstall {other.distribution!r} or "
                f"{plugin.distribution!r}"
            )
    return MappingProxyType(plugins)


def find(group: Group, name: str) -> Plugin:
    """Return the plugin of that name.

    Raises:
        PluginError: there is none; names what there is.
    """
    plugins = found(group)
    if name not in plugins:
        hint = config.did_you_mean(name, plugins)
        raise PluginError(f"no {role(group)} is called {name!r}{hint}")
    return plugins[name]


def make(group: Group, name: str, parameters: Mapping[str, Any] = MappingProxyType({})) -> Any:
    """Load a plugin whose object is a dataclass and return an instance with these parameters.

    Args:
        group, name: of the entry point.
        parameters: by field of the dataclass; each is read as the field's annotation says, see
            :func:`spoofbench.config.read`.

    Raises:
        PluginError: it cannot be loaded, has no such parameter, or refuses a value.
    """
    plugin = find(group, name)
    factory = plugin.load()
    if not (isinstance(factory, type) and is_dataclass(factory)):
        raise PluginError(f"{plugin} is not a dataclass, so it has no parameters")
    made: Any = config.read(factory, parameters, str(plugin), noun="parameter", error=PluginError)
    return made
