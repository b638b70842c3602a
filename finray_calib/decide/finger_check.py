"""Reports on captures must be on the finger of the sweep: errors of another one say nothing about its curve."""

from collections.abc import Sequence

from data_schemas.compare import PhotometricErrorReport
from data_schemas.errors import DecideError
from data_schemas.finger_identity import finger_identity
from data_schemas.simulate import LightAngleSweep

#: Depths this near are one press: what is typed into two files.
_SAME_DEPTH_MM = 1e-6


def require_one_finger(sweep: LightAngleSweep, reports: Sequence[PhotometricErrorReport]) -> tuple[str, ...]:
    """Refuse reports on another finger than the sweep's, and return notes on what cannot be told.

    The angle of the light is what the sweep varies, the depth of the press what a session varies: neither makes another
    finger, but another depth is told.

    Raises
    ------
    DecideError
        A report is on another finger, or with another light or indenter.
    """
    own = finger_identity(sweep.design)
    notes = []
    for report in reports:
        if report.finger is None:
            notes.append(
                f"the report on {report.captured} does not say which finger was rendered (it is of an older "
                f"version, or of a press without a design): whether it is '{own.name}' is taken on trust"
            )
            continue
        if report.finger.version != own.version:
            notes.append(
                f"the report on {report.captured} names its finger '{report.finger.name}' as another version of finray "
                f"does: whether it is '{own.name}' is taken on trust; compare again to know"
            )
            continue
        other = report.finger.differs_in(own)
        if other:
            raise DecideError(
                f"the report on {report.captured} is on the finger '{report.finger.name}', the sweep '{sweep.name}' on "
                f"'{own.name}', and they differ in {', '.join(other)}: an error of one says nothing about the light of "
                "the other. Simulate and compare the capture with the sweep's design, or leave the report out"
            )
        if abs(report.finger.depth_mm - own.depth_mm) > _SAME_DEPTH_MM:
            notes.append(
                f"the render compared with {report.captured} was pressed {report.finger.depth_mm:g} mm deep, the sweep "
                f"is of {own.depth_mm:g} mm: the error is that of another depth"
            )
    return tuple(notes)
