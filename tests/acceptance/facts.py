"""Facts of a flawless rig, to be spoilt one by one."""

from data_schemas import (
    BlockedLight,
    CheckFacts,
    CheckPlan,
    DarkFrames,
    DeviceIdentity,
    ExposureLevel,
    FilterProof,
    Handshake,
    LatencyTry,
    LightOff,
    PictureShift,
    RegionOfInterest,
    Revisit,
    SightLevels,
    StrayLight,
    TriggerLatency,
    WarmUp,
    WheelMove,
)

PLAN = CheckPlan(
    check_name="lab",
    region=RegionOfInterest(row_px=0, column_px=0, height_px=20, width_px=20),
    texture_is_of_the_tile=True,
)


def handshake(role: str = "camera", driver: str = "aravis", **changed: object) -> Handshake:
    said = DeviceIdentity.model_validate({"role": role, "driver": driver, "model": "X1", "serial": "007"})
    given = {"role": role, "driver": driver, "identity": said, "durations_s": (0.1, 0.3, 0.2), **changed}
    return Handshake.model_validate(given)


def dark(exposure_s: float, *means_dn: float, noise_dn: float = 1.41439, **changed: float) -> DarkFrames:
    return DarkFrames.model_validate(
        {"exposure_s": exposure_s, "means_dn": means_dn, "noise_dn": noise_dn, "at_zero_fraction": 0.0, "pixels": 400}
        | changed
    )


def level(exposure_s: float, signal_dn: float, scatter_dn: float = 0.1) -> ExposureLevel:
    apart = (-scatter_dn, scatter_dn) * 3
    return ExposureLevel(
        exposure_s=exposure_s,
        white_dn=tuple(16.0 + signal_dn + a for a in apart),
        dark_dn=tuple(16.0 + a for a in apart),
    )


HANDSHAKES = (handshake(), handshake("filter wheel"), handshake("laser"), handshake("lamp"))


SIGHT = SightLevels(
    exposure_s=0.02, on_dn=2018.0, off_dn=18.0, off_sd_dn=0.05, blocked_filter="550", blocked_on_dn=18.1,
    blocked_off_dn=18.0, threshold_dn=19.0,
)  # fmt: skip
GOOD = CheckFacts(
    handshakes=HANDSHAKES,
    moves=tuple(WheelMove(from_slot=1, to_slot=2, arrived_slot=2, duration_s=s) for s in (0.5, 1.5)),
    darks=(dark(0.001, 16.0, 16.01), dark(0.5, 16.1, 16.11), dark(1.0, 16.2, 16.21)),
    filter_proof=FilterProof(verdict="confirmed", text="the frames show every filter in its slot"),
    revisit_filter="600",
    revisits=tuple(
        Revisit(
            still_rel=0.001,
            moved_rel=sign * 0.002,
            still_px=PictureShift(row_px=0.0, column_px=0.01, sd_px=0.02),
            moved_px=PictureShift(row_px=sign * 0.06, column_px=0.08, sd_px=0.02),
        )
        for sign in (1, -1, 1, -1)
    ),
    levels=(level(0.1, 100.0), level(0.2, 200.0), level(0.4, 400.0)),
    white_span_s=20.0,
    frame_overheads_s=(0.2, 0.3),
    warm_up=WarmUp(
        filter_name="600",
        times_s=tuple(4.0 * k for k in range(40)),
        white_dn=tuple(1000.0 * (1.0 - 0.04 * 0.5 ** (k / 2)) for k in range(40)),
        dark_before_dn=(16.0, 16.02, 16.01, 16.0, 16.01),
        dark_after_dn=(16.1, 16.12, 16.11, 16.1, 16.11),
    ),
    stray_light=StrayLight(
        passed=BlockedLight(filter_name="450", level=level(0.01, 800.0)),
        blocked=(
            BlockedLight(filter_name="550", level=level(1.0, 2.0)),
            BlockedLight(filter_name="600", level=level(1.0, 8.0)),
        ),
    ),
    latency=TriggerLatency(
        exposure_s=0.4,
        tries=tuple(
            LatencyTry(on_earliest_s=0.2, on_latest_s=0.22, lit_share=share, lit_share_sd=0.002)
            for share in (0.60, 0.61, 0.59, 0.60)
        ),
    ),
    reconnect_s=8.0,
    reconnected=tuple(hand.identity for hand in HANDSHAKES if hand.identity is not None),
    light_off=(
        LightOff(layer="block", witness="its own connection", earliest_s=(0.0,), latest_s=(0.1,)),
        LightOff(layer="guard", witness="a new connection", earliest_s=(0.0, 0.1), latest_s=(0.1, 0.3)),
        LightOff(layer="dead-man", witness="the camera", earliest_s=(0.8,), latest_s=(0.9,)),
    ),
    sight=SIGHT,
)


def spoilt(**changed: object) -> CheckFacts:
    return CheckFacts.model_validate(GOOD.model_dump() | changed)
