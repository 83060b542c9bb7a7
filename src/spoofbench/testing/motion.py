"""The motion of a car that never existed: starts, turns, hills and stops, exactly differentiable.

Speed, curvature and slope are drawn at random knots and smoothed; attitude, velocity, position,
specific force and angular rate follow from them, so that the sensors made from it agree as real
ones do.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STEP_S = 0.01
GRAVITY_MPS2 = 9.80665
_LATERAL_LIMIT_MPS2 = 4.0


@dataclass(frozen=True, slots=True)
class VehicleMotion:
    """True motion every 10 ms; body frame forward-right-down, roll zero.

    Attributes:
        time_s: ``(n,)`` from 0.
        velocity_mps: ``(n, 3)`` NED.
        position: ``(n, 3)`` latitude and longitude in degrees, ellipsoidal height in metres.
        attitude_rad: ``(n, 3)`` roll, pitch, yaw.
        specific_force_mps2: ``(n, 3)`` in the body frame, mean over the 10 ms that end at
            ``time_s``.
        angular_rate_radps: ``(n, 3)`` of the body, mean over the same 10 ms.
    """

    time_s: Floats
    velocity_mps: Floats
    position: Floats
    attitude_rad: Floats
    specific_force_mps2: Floats
    angular_rate_radps: Floats


def make_motion(rng: np.random.Generator, duration_s: float) -> VehicleMotion:
    """Draw a drive: parked for the first 10 s, then legs of 12 to 30 s with a stop after every
    other one.
    """
    time_s: Floats = np.arange(round(duration_s / STEP_S) + 1, dtype=np.float64) * STEP_S
    speed, curvature = _speed_and_curvature(rng, time_s)
    distance = _integrate(speed)
    wavelengths = rng.uniform(250, 900, 4)
    pitch: Floats = np.sum(
        0.012 * np.sin(2 * np.pi * distance[:, None] / wavelengths + rng.uniform(0, 2 * np.pi, 4)),
        axis=1,
    )
    yaw = rng.uniform(-np.pi, np.pi) + _integrate(curvature * speed)
    velocity = speed[:, None] * np.column_stack(
        [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)]
    )
    attitude = np.column_stack([np.zeros_like(pitch), pitch, yaw])
    return VehicleMotion(
        time_s, velocity, _positions(rng, velocity), attitude, *_inertial(velocity, attitude)
    )


def _speed_and_curvature(rng: np.random.Generator, time_s: Floats) -> tuple[Floats, Floats]:
    knots, speeds, turns, now = [0.0, 10.0], [0.0, 0.0], [], 10.0
    stop = False
    while now < time_s[-1]:
        ramp, stay = rng.uniform(5, 9), rng.uniform(4, 12) if stop else rng.uniform(7, 20)
        pace = 0.0 if stop else rng.uniform(7, 18)
        knots += [now + ramp, now + ramp + stay]
        speeds += [pace, pace]
        turns.append(
            (now + rng.uniform(0.2, 0.8) * ramp, rng.choice([-1, 1]) * rng.uniform(0.01, 0.06))
        )
        now += ramp + stay
        stop = not stop
    speed = _smooth(np.interp(time_s, knots, speeds), 1.5)
    throttle = np.sin(
        2 * np.pi * time_s[:, None] / rng.uniform(3, 9, 3) + rng.uniform(0, 2 * np.pi, 3)
    )
    speed = speed * (1 + throttle @ rng.uniform(0.005, 0.02, 3))
    curvature: Floats = np.zeros_like(time_s)
    for centre, strength in turns:
        curvature += strength * np.exp(-0.5 * ((time_s - centre) / 2.0) ** 2)
    return speed, curvature / (1 + np.abs(curvature) * speed**2 / _LATERAL_LIMIT_MPS2)


def _smooth(values: Floats, width_s: float) -> Floats:
    kernel = np.hanning(round(width_s / STEP_S) | 1)
    padded = np.pad(values, kernel.size // 2, mode="edge")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")


def _integrate(rate: Floats) -> Floats:
    """Trapezoidal integral over time along the first axis, 0 at the start."""
    total = np.zeros_like(rate)
    np.cumsum((rate[1:] + rate[:-1]) * (STEP_S / 2), axis=0, out=total[1:])
    return total


def _positions(rng: np.random.Generator, velocity: Floats) -> Floats:
    from pymap3d.rcurve import meridian, transverse

    north, east, down = _integrate(velocity).T
    latitude0, longitude0, height0 = (
        np.radians(rng.uniform(35, 55)),
        np.radians(rng.uniform(-120, 20)),
        rng.uniform(50, 500),
    )
    north_m, east_m = (
        meridian(latitude0, deg=False) + height0,
        (transverse(latitude0, deg=False) + height0) * np.cos(latitude0),
    )
    return np.column_stack(
        [
            np.degrees(latitude0 + north / north_m),
            np.degrees(longitude0 + east / east_m),
            height0 - down,
        ]
    )


def _inertial(velocity: Floats, attitude: Floats) -> tuple[Floats, Floats]:
    rates = np.diff(attitude, axis=0) / STEP_S
    middle = (attitude[1:] + attitude[:-1]) / 2
    force_ned = np.diff(velocity, axis=0) / STEP_S - [0.0, 0.0, GRAVITY_MPS2]
    force = np.einsum("nij,nj->ni", body_from_ned(middle), force_ned)
    pitch = middle[:, 1]
    angular = np.column_stack(
        [-rates[:, 2] * np.sin(pitch), rates[:, 1], rates[:, 2] * np.cos(pitch)]
    )
    return np.vstack([force[:1], force]), np.vstack([angular[:1], angular])


def body_from_ned(attitude_rad: Floats) -> Floats:
    """Rotation from NED to forward-right-down for roll, pitch, yaw ``(n, 3)``; shape ``(n, 3,
    3)``.
    """
    (sr, sp, sy), (cr, cp, cy) = np.sin(attitude_rad).T, np.cos(attitude_rad).T
    rows = [
        [cp * cy, cp * sy, -sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
        [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
