# SPDX-License-Identifier: Apache-2.0
"""What tracking is tried on: cameras and IMUs that are not as they should be, and what is wanted there."""
import dataclasses

from . import faults


@dataclasses.dataclass(frozen=True)
class Scenario:
    name: str
    what: str
    generate: tuple = ()  # options of generate_sequence
    faults: tuple = ()  # functions of faults.py, or of a seed that give one
    imu: bool = False  # tracked with the IMU, and beside it without
    limits: tuple = ()  # (figure of a row, largest value)
    least: tuple = ()  # (figure of a row, smallest value)
    frames: int = 300
    track: tuple = ()  # options of track_sequence


def seeded(make):
    """A fault that needs the seed of its sequence."""
    make.needs_seed = True
    return make


def fault_of(entry, seed):
    return entry(seed) if getattr(entry, "needs_seed", False) else entry


CORRIDOR = ("--scene", "corridor")
SLOW = (*CORRIDOR, "--speed", "1.2")
WHOLE = (("lost", 0), ("maps", 1), ("silent", 0))
TRUTHFUL = (("silent", 0),)
TOLD = (("warned", 1),)
UNTOLD = (("warned", 0),)


def within(ate=None, rpe_frame=None):
    """Limits in metres."""
    return tuple((n, v) for n, v in (("ate_m", ate), ("rpe_frame_m", rpe_frame)) if v is not None)


IMAGES = (
    Scenario(
        "clean", "as generated", limits=(*WHOLE, *UNTOLD, *within(0.01, 0.001), ("keyframe_share", 0.15), ("contained", 0.98)),
        least=(("contained", 0.9),),
    ),
    Scenario("clean_fisheye", "two fisheye cameras", ("--rig", "fisheye"), limits=(*WHOLE, *UNTOLD, *within(0.025))),
    Scenario("every_2nd", "10 frames a second", faults=(faults.every(2),), limits=(*WHOLE, *within(0.005))),
    Scenario("every_4th", "5 frames a second", faults=(faults.every(4),), limits=(*WHOLE, *within(0.015))),
    Scenario("gap", "a second without images", faults=(faults.without_images(4, 5),), limits=(("maps", 1), ("silent", 0))),
    Scenario(
        "fast_turn", "120 degrees and back in 1.5 s, 15 ms of exposure",
        ("--fast-turn", "3", "4.5", "120", "--exposure", "15"), limits=(*WHOLE, *within(0.025, 0.003)),
    ),
    Scenario(
        "half_turn", "180 degrees and back in 1 s", ("--fast-turn", "3", "4", "180"),
        limits=(("maps", 1), ("silent", 0), *within(0.06)),
    ),
    Scenario(
        "jumps", "31 jumps of up to 1.2 m and 25 degrees", ("--fast-turn", "1", "5.5", "50"), faults=(faults.jumps(31),), limits=TRUTHFUL, least=(("jumps_right", 0.8),),
    ),
    *(
        Scenario(
            f"{kind}_{share}", f"{kind} on {share} % of the image, fixed to the cameras; driving", (*SLOW, f"--{kind}", share),
            limits=(*TRUTHFUL, ("ate_share", 0.02)), least=TOLD, frames=140,
        )
        for kind in ("bonnet", "dirt") for share in ("25", "40")
    ),
    Scenario("companion", "a thing on 40 % of the image goes along", (*SLOW, "--companion", "40"), limits=TRUTHFUL, frames=140),
    Scenario(
        "crossing", "a thing on 40 % of the image crosses at 0.5 m/s; at rest", (*CORRIDOR, "--speed", "0", "--crossing", "40"),
        limits=TRUTHFUL, frames=100,
    ),
    Scenario("crossing_driving", "the same while driving", (*SLOW, "--crossing", "40"), limits=TRUTHFUL, frames=140),
    Scenario(
        "repeated_ahead", "a corridor that repeats after 2 m, 0.8 s without light", (*SLOW, "--repeat", "2", "--blind", "4", "4.8"),
        limits=TRUTHFUL, frames=140,
    ),
    Scenario(
        "repeated_aside", "a facade that repeats after 1 m, 0.8 s without light",
        (*SLOW, "--repeat", "1", "--look-aside", "90", "--blind", "4", "4.8"), limits=TRUTHFUL, frames=140,
    ),
    Scenario("rolling_shutter", "rows are read in 33 ms", ("--readout", "33"), limits=(*WHOLE, *within(0.015))),
    Scenario("late_right", "the right image is one frame late", faults=(faults.late_right(),), limits=TRUTHFUL, least=TOLD),
    Scenario("rows_apart", "rows of the pair are 2 pixels apart", faults=(faults.rows_apart(2),), limits=TRUTHFUL, least=TOLD),
    Scenario(
        "left_repeated", "the left image is the same for half a second",
        faults=(faults.repeated_images(4, 4.5, (0,)),), limits=TRUTHFUL, least=TOLD,
    ),
    Scenario(
        "at_rest", "does not move", (*CORRIDOR, "--speed", "0"), limits=(*WHOLE, *UNTOLD, ("deviation_at_rest", 2.0)),
        least=(("deviation_at_rest", 0.5),), frames=100,
    ),
    Scenario("corridor_8", "forward at 8 m/s", (*CORRIDOR, "--speed", "8"), limits=(*WHOLE, ("ate_share", 0.01)), frames=160),
)


def with_imu(name, what, *made, **more):
    """Wanted of each: never worse than without the IMU."""
    limits = (*TRUTHFUL, ("ate_over_allowed", 1.0), ("max_over_allowed", 1.0), *more.pop("limits", ()))
    return Scenario(name, what, faults=made, imu=True, limits=limits, **more)


def bias(amount):
    return seeded(lambda seed: faults.sensor_bias("accel", amount, seed))


def turned(degrees):
    return seeded(lambda seed: faults.turned_imu(degrees, seed))


SIXTEEN_G = 16 * faults.GRAVITY
TWO_THOUSAND_DEGREES = 34.9

INERTIAL = (
    with_imu("imu", "as generated", limits=(("lost", 0), ("gain", 0.6)), least=(("imu_used", 0.9),)),
    with_imu("imu_fisheye", "two fisheye cameras", generate=("--rig", "fisheye")),
    with_imu("imu_gap", "a second without images", faults.without_images(4, 5), limits=(("gap_share", 0.01),)),
    with_imu("imu_every_4th", "5 frames a second", faults.every(4)),
    with_imu(
        "imu_fast_turn", "120 degrees and back in 1.5 s, 15 ms of exposure",
        generate=("--fast-turn", "3", "4.5", "120", "--exposure", "15"),
    ),
    with_imu(
        "imu_fast_turn_mount_5", "the same with an IMU that is turned by 5 degrees", turned(5),
        generate=("--fast-turn", "3", "4.5", "120", "--exposure", "15"), least=TOLD,
    ),
    *(with_imu(f"accel_bias_{b}", f"accelerometer's bias of {b} m/s^2 in any direction", bias(b)) for b in (0.1, 0.3, 0.7, 1.4)),
    with_imu("spike_accel", "one sample of 16 g", faults.spike("accel", SIXTEEN_G, 4)),
    with_imu("spike_gyro", "one sample of 2000 degrees/s", faults.spike("gyro", TWO_THOUSAND_DEGREES, 4)),
    with_imu("bit_error", "one sample of 1e7", faults.spike("accel", 1e7, 4)),
    with_imu("saturation", "16 g for 0.1 s", faults.saturated("accel", SIXTEEN_G, 4, 4.1)),
    with_imu("zeros", "samples of zeros for half a second", faults.held_samples(4, 4.5, zeros=True)),
    with_imu("frozen_samples", "the same sample for half a second", faults.held_samples(4, 4.5)),
    *(
        with_imu(
            f"clock_{'late' if ms > 0 else 'early'}_{abs(ms)}", f"the IMU's stamps are {abs(ms)} ms {'late' if ms > 0 else 'early'}",
            faults.late_clock(ms), least=TOLD if abs(ms) >= 20 else (),
        )
        for ms in (-100, -30, -20, -10, -5, -2, 2, 5, 10, 20, 30, 100)
    ),
    with_imu("accel_in_g", "accelerometer in g", faults.scaled("accel", 1 / faults.GRAVITY), least=TOLD),
    with_imu("gyro_in_degrees", "gyroscope in degrees/s", faults.scaled("gyro", 57.29577951308232), least=TOLD),
    with_imu("axes_swapped", "x and y of the IMU swapped", faults.swapped_axes, least=TOLD),
    with_imu("extrinsics_inverted", "from the body to the cameras instead of back", faults.inverted_extrinsics, least=TOLD),
    *(with_imu(f"mount_{d}", f"the IMU is turned by {d} degrees from where its calibration says", turned(d)) for d in (0.5, 2, 5)),
    with_imu("imu_stops", "no samples after 4 s", faults.only_samples(end_s=4)),
    with_imu("imu_starts_late", "no samples before 4 s", faults.only_samples(begin_s=4)),
    with_imu("rate_twice", "rate_hz is twice that of the samples", faults.wrong_rate(2)),
    with_imu("rate_half", "rate_hz is half that of the samples", faults.wrong_rate(0.5)),
    with_imu(
        "images_repeated", "both images are the same for half a second",
        faults.repeated_images(4, 4.5), limits=(("ate_m", 0.015),), least=TOLD,
    ),
    with_imu(
        "imu_left_repeated", "the left image is the same for half a second",
        faults.repeated_images(4, 4.5, (0,)), limits=(("ate_m", 0.015),), least=TOLD,
    ),
)

ALL = (*IMAGES, *INERTIAL)
