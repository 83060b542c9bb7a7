"""Which topics of a bag are taken, which are one device, and what their sources are called.

A topic is a device and a source, but for receivers: position, velocity, satellites and time
reference beside one another in one namespace are one. Sources are numbered by their topics' names,
so that a session gives the same in every kind of bag.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from spoofbench_converters.rosbag.batches import BagTopic
from spoofbench_converters.rosbag.contract import Options
from spoofbench_converters.rosbag.messages import Spec

_VELOCITY = re.compile(r"(.*_)?vel(ocity)?(_.*)?")
_COMMANDED = re.compile(r"cmd|command|desired|target|setpoint")
_WHEELS = re.compile(r"odom|wheel")
_OTHERWISE = re.compile(
    r"filter|fused|fusion|ekf|ukf|kalman|locali[sz]ation|global|gps|gnss|\bins\b|visual|vio|slam|lidar|laser"
)
_FILTERED = re.compile(
    r"filter|fused|fusion|ekf|ukf|kalman|locali[sz]ation|global_position/global$"
)

NOT_ASKED = "not asked for"
_TWIST = (
    "a twist that nothing says to be a receiver's velocity; if it is, in east, north, up, name it "
    "with -p velocity=TOPIC"
)
_SECOND_TWIST = "a second velocity of one receiver"
_ODOMETRY = "odometry that nothing says to be of wheels; if it is, name it with -p odometer=TOPIC"


@dataclass(frozen=True, slots=True)
class Output:
    """Where a topic's rows of one kind go; those of ``paired`` outputs of one source are joined."""

    source: str
    kind: str
    paired: bool = False


@dataclass(slots=True)
class Plan:
    """What becomes of a bag's topics.

    Attributes:
        devices: topics that are on one clock.
        outputs: by number of a topic.
        sources: metadata by source.
        declined: why topics are not taken whose types are known, by number.
        asked: beginnings of the kinds of which one device alone is asked for.
        primary: the source whose solution has position and velocity and is not filtered, if the
            first in the order of names has not.
    """

    devices: list[list[BagTopic]] = field(default_factory=list)
    outputs: dict[int, list[Output]] = field(default_factory=dict)
    sources: dict[str, dict[str, str]] = field(default_factory=dict)
    declined: dict[int, str] = field(default_factory=dict)
    asked: frozenset[str] = frozenset()
    primary: str | None = None


def plan(topics: Sequence[BagTopic], specs: Mapping[int, Spec], options: Options) -> Plan:
    """Return what becomes of those of a bag's topics that have a spec, by number."""
    made = Plan()
    known = sorted(
        (topic for topic in topics if topic.number in specs),
        key=lambda topic: (topic.name, topic.type),
    )
    for topic in known:
        reason = _declined(topic, known, specs, options)
        if reason:
            made.declined[topic.number] = reason
    made.devices = _devices([topic for topic in known if topic.number not in made.declined], specs)
    if options.source is not None and options.source not in {
        topic.name for topic in known if topic.number in made.declined
    }:
        _keep_only(options.source, made, specs)
    for device in made.devices:
        _second_velocities(device, specs, made)
        _name(device, specs, made)
    complete = [
        source
        for source, about in made.sources.items()
        if "velocity" in about and about.get("solution") == "gnss"
    ]
    if complete and complete[0] != min(
        source for source in made.sources if source.startswith("gnss")
    ):
        made.primary = complete[0]
    for about in made.sources.values():
        if about.get("velocity") == "":
            del about["velocity"]
    return made


def _declined(
    topic: BagTopic, known: Sequence[BagTopic], specs: Mapping[int, Spec], options: Options
) -> str | None:
    spec, last = specs[topic.number], topic.name.rpartition("/")[2].lower()
    if topic.type.startswith("geometry_msgs/") and options.velocity != topic.name:
        beside = any(
            specs[other.number].side == "position" and _parent(other) == _parent(topic)
            for other in known
        )
        called = bool(_VELOCITY.fullmatch(last)) and not _COMMANDED.search(last)
        if options.velocity != "auto" or not beside or not called:
            return _TWIST
    if (
        spec.kinds == ("odometer",)
        and topic.type.startswith("nav_msgs/")
        and options.odometer != topic.name
    ):
        name = topic.name.lower()
        if options.odometer != "auto" or not _WHEELS.search(name) or _OTHERWISE.search(name):
            return _ODOMETRY
    return None


def _keep_only(source: str, made: Plan, specs: Mapping[int, Spec]) -> None:
    """Decline the devices that are of a kind with that which has the topic asked for; a topic
    without a spec is a receiver's bytes.
    """
    asked = [device for device in made.devices if any(topic.name == source for topic in device)]
    made.asked = (
        frozenset().union(*(_kinds(device, specs) for device in asked))
        if asked
        else frozenset({"gnss"})
    )
    for device in [
        device
        for device in made.devices
        if device not in asked and _kinds(device, specs) & made.asked
    ]:
        made.devices.remove(device)
        made.declined |= dict.fromkeys((topic.number for topic in device), NOT_ASKED)


def _kinds(device: Sequence[BagTopic], specs: Mapping[int, Spec]) -> frozenset[str]:
    return frozenset(
        kind.partition("/")[0] for topic in device for kind in specs[topic.number].kinds
    )


def _parent(topic: BagTopic) -> str:
    return topic.name.rpartition("/")[0]


def _is_gnss(spec: Spec) -> bool:
    return any(kind.startswith("gnss/") for kind in spec.kinds)


def _devices(topics: Sequence[BagTopic], specs: Mapping[int, Spec]) -> list[list[BagTopic]]:
    devices: list[list[BagTopic]] = [
        [topic] for topic in topics if not _is_gnss(specs[topic.number])
    ]
    namespaces: dict[str, list[BagTopic]] = {}
    for topic in topics:
        if _is_gnss(specs[topic.number]):
            namespaces.setdefault(_parent(topic), []).append(topic)
    for mine in namespaces.values():
        solutions = [
            topic
            for topic in mine
            if "gnss/pvt" in specs[topic.number].kinds and specs[topic.number].side != "velocity"
        ]
        heads: list[list[BagTopic]] = [[topic] for topic in solutions] or [[mine[0]]]
        for topic in mine:
            if topic not in [head[0] for head in heads]:
                max(heads, key=lambda head: _alike(head[0].name, topic.name)).append(topic)
        devices += heads
    return sorted(devices, key=lambda device: device[0].name)


def _alike(one: str, other: str) -> int:
    """Return how many characters two names start with in common."""
    return next(
        (place for place, (a, b) in enumerate(zip(one, other, strict=False)) if a != b),
        min(len(one), len(other)),
    )


def _second_velocities(device: list[BagTopic], specs: Mapping[int, Spec], made: Plan) -> None:
    for topic in [topic for topic in device if specs[topic.number].side == "velocity"][1:]:
        made.declined[topic.number] = _SECOND_TWIST
        device.remove(topic)


def _name(device: Sequence[BagTopic], specs: Mapping[int, Spec], made: Plan) -> None:
    """Name the sources of a device."""
    sides = [specs[topic.number].side for topic in device]
    paired = "position" in sides and "velocity" in sides
    named: dict[str, str] = {}
    for topic in device:
        spec = specs[topic.number]
        for kind in spec.kinds:
            prefix = kind.partition("/")[0]
            if prefix not in named or (prefix != "gnss" and topic is not device[0]):
                alike = [source.rstrip("0123456789") for source in made.sources].count(prefix)
                named[prefix] = f"{prefix}{alike}"
            about = made.sources.setdefault(named[prefix], {})
            about["topic"] = " ".join(
                dict.fromkeys([*about.get("topic", "").split(" "), topic.name])
            ).strip()
            about.update(spec.about.get(kind, {}))
            made.outputs.setdefault(topic.number, []).append(
                Output(named[prefix], kind, paired and kind == "gnss/pvt" and bool(spec.side))
            )
            if kind == "gnss/pvt":
                _describe_solution(about, topic, spec, paired)


def _describe_solution(about: dict[str, str], topic: BagTopic, spec: Spec, paired: bool) -> None:
    filtered = bool(_FILTERED.search(topic.name.lower()))
    about.setdefault("solution", "fused" if filtered else "gnss")
    about.setdefault(
        "solution_basis",
        "the topic is called after a filter"
        if filtered
        else "a receiver's message, not called after a filter",
    )
    if paired:
        about["velocity"] = (
            "a twist in east, north, up (REP 103), joined where the stamps are equal"
        )
    elif not spec.side:
        about.setdefault("velocity", "")
