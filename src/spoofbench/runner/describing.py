"""A worker that loads a plugin and says what it is, so that its code never runs in the main
process.
"""

from dataclasses import fields
from typing import Any

from spoofbench import plugins
from spoofbench.detector import Detector
from spoofbench.errors import PluginError
from spoofbench.runner.talk import Talk, one_line
from spoofbench.suite import RATE_PARAMETER


def work(
    talk: Talk,
    group: plugins.Group,
    name: str,
    parameters: dict[str, Any],
    rate_per_hour: float | None,
) -> None:
    """Send all parameters of the plugin, and its contract.

    The status is ``failed`` if it cannot be loaded, ``refused`` if it does not take the suite's
    parameters.
    """
    plugin = plugins.find(group, name)
    try:
        factory = plugin.load()
    except PluginError as error:
        talk.send(status="failed", reason=one_line(error))
        return
    if rate_per_hour is not None and RATE_PARAMETER in getattr(factory, "__dataclass_fields__", {}):
        parameters = {RATE_PARAMETER: rate_per_hour, **parameters}
    try:
        made = plugins.make(group, name, frozen(parameters))
    except PluginError as error:
        talk.send(status="refused", reason=str(error))
        return
    if group == plugins.DETECTORS and not isinstance(made, Detector):
        talk.send(
            status="failed",
            reason=f"PluginError: {plugin} is no detector; it needs requires, uses, memory_s and detect()",
        )
        return
    try:
        about: dict[str, Any] = {
            "parameters": {
                field.name: plain(getattr(made, field.name)) for field in fields(made) if field.init
            }
        }
        if group == plugins.DETECTORS:
            kinds = {
                name: [str(kind) for kind in getattr(made, name)] for name in ("requires", "uses")
            }
            about |= {**kinds, "memory_s": float(made.memory_s)}
        else:
            about |= {"models": sorted(map(str, made.models))}
    except Exception as error:  # noqa: BLE001, properties of a plugin may raise anything
        talk.send(status="failed", reason=one_line(error))
        return
    talk.send(status="ok", **about)


def frozen(value: Any) -> Any:
    """Return a parameter with tuples for lists, as a frozen dataclass wants it."""
    if isinstance(value, dict):
        return {key: frozen(item) for key, item in value.items()}
    return tuple(map(frozen, value)) if isinstance(value, list | tuple) else value


def plain(value: Any) -> Any:
    """Return a parameter as JSON can say it; what JSON has no word for as text."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
