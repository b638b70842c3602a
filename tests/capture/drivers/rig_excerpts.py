"""Rig-file excerpts of INDI devices, shared by the tests of their drivers."""

from data_schemas import BandPassFilter, CameraSettings, FilterWheelSettings


def wheel_settings(address: str, driver: str = "indi", count: int = 3) -> FilterWheelSettings:
    filters = tuple(
        BandPassFilter(slot=slot, name=f"F{slot}", center_nm=400.0 + 20.0 * slot) for slot in range(1, count + 1)
    )
    return FilterWheelSettings.model_validate({"driver": driver, "address": address, "filters": filters})


def camera_settings(address: str, **others: object) -> CameraSettings:
    return CameraSettings.model_validate({"driver": "indi", "address": address, **others})
