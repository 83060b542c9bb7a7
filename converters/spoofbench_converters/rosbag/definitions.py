"""Message definitions: those in the bag, in a folder that the user gives, those of ROS itself, and
those written out here.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spoofbench.errors import ConversionError

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

MAX_DEFINITION_BYTES = 1_048_576
_MAX_BAG_DEFINITION_BYTES = 65_536  # of one topic; parsing takes time

Definitions = Mapping[str, tuple[Any, Sequence[tuple[str, Any]]]]
"""Constants and fields by message type, as rosbags parses them."""


def normal_name(name: str) -> str:
    """Return ``<package>/msg/<Type>`` of a type's name in ROS 1 or ROS 2."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest.rpartition('/')[2]}" if rest else name


def parse(text: str, name: str, form: str = "ros2msg") -> "Typesdict":
    """Return the definitions in the text of a type ``package/msg/Type``, and of those within it
    that follow in the same text.

    Raises:
        ConversionError: it is not a message definition.
    """
    from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

    try:
        if form == "ros2idl":
            return get_types_from_idl(text)
        return get_types_from_msg(text, name)
    except (TypesysError, RecursionError) as error:
        raise ConversionError(f"the definition of {name!r} cannot be parsed: {error}") from error


def of_bag(text: str, name: str, form: str) -> Definitions:
    """Return the definitions that a bag gives for a topic, none where it gives none or they cannot
    be parsed.
    """
    if not text.strip() or len(text) > _MAX_BAG_DEFINITION_BYTES:
        return {}
    try:
        return parse(text, name, form)
    except ConversionError:
        return {}


@cache
def of_ros(generation: int) -> Definitions:
    """Return the definitions that ROS 1 or 2 itself comes with."""
    from rosbags.typesys import Stores, get_typestore

    return dict(get_typestore(Stores.ROS1_NOETIC if generation == 1 else Stores.LATEST).fielddefs)


def read_folder(folder: Path, types: Iterable[str]) -> Definitions:
    """Return the definitions in a folder's ``.msg`` files.

    A file is ``<package>/msg/<Type>.msg`` or ``<package>/<Type>.msg`` somewhere below the folder,
    ``<package>__<Type>.msg``, or ``<Type>.msg`` for each package among ``types``.

    Raises:
        ConversionError: the folder has none, or one of them cannot be parsed.
    """
    packages = sorted({name.partition("/")[0] for name in types})
    definitions: dict[str, Any] = {}
    for path in sorted(folder.rglob("*.msg")):
        if path.stat().st_size > MAX_DEFINITION_BYTES:
            raise ConversionError(
                f"the definition {path.name!r} is larger than {MAX_DEFINITION_BYTES:,} bytes"
            )
        text = path.read_text("utf-8", errors="replace")
        package, _, name = path.stem.rpartition("__")
        parent = path.parent.parent if path.parent.name == "msg" else path.parent
        owners = (
            [package]
            if package
            else [parent.name]
            if parent.name in packages or parent != folder
            else packages
        )
        for owner in owners:
            definitions.update(parse(text, f"{owner}/msg/{name}"))
    if not definitions:
        raise ConversionError(f"the folder of definitions {str(folder)!r} holds no .msg file")
    return definitions


@cache
def known() -> Definitions:
    """Return the definitions that are written out here, for bags that have none: fields and types
    of public packages.
    """
    parsed: dict[str, Any] = {}
    for name, text in _KNOWN.items():
        parsed.update(parse(text, name))
    return parsed


_GPS_STATUS = (
    "std_msgs/Header header\nuint16 satellites_used\nint32[] satellite_used_prn\nuint16 "
    "satellites_visible\n"
    "int32[] satellite_visible_prn\nint32[] satellite_visible_z\nint32[] "
    "satellite_visible_azimuth\nint32[] satellite_visible_snr\n"
    "int16 status\nuint16 motion_source\nuint16 orientation_source\nuint16 position_source\n"
)
_GPS_FIX = (
    "std_msgs/Header header\nGPSStatus status\nfloat64 latitude\nfloat64 longitude\nfloat64 "
    "altitude\nfloat64 track\nfloat64 speed\n"
    "float64 climb\nfloat64 pitch\nfloat64 roll\nfloat64 dip\nfloat64 time\nfloat64 gdop\nfloat64 "
    "pdop\nfloat64 hdop\nfloat64 vdop\n"
    "float64 tdop\nfloat64 err\nfloat64 err_horz\nfloat64 err_vert\nfloat64 err_track\nfloat64 "
    "err_speed\nfloat64 err_climb\n"
    "float64 err_time\nfloat64 err_pitch\nfloat64 err_roll\nfloat64 err_dip\n"
    "float64[9] position_covariance\nuint8 position_covariance_type\n"
)
_KNOWN = {
    **{f"{package}/msg/GPSStatus": _GPS_STATUS for package in ("gps_common", "gps_msgs")},
    **{f"{package}/msg/GPSFix": _GPS_FIX for package in ("gps_common", "gps_msgs")},
    "nmea_msgs/msg/Sentence": "std_msgs/Header header\nstring sentence\n",
}
