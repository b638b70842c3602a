"""A decision takes reports on its own finger only."""

import hashlib

import pytest

from data_schemas import DecideError, FingerDesign, PhotometricErrorReport, finger_identity
from data_schemas._design import _PARTS, VERSION, FingerIdentity
from finray_calib.compare import compare_press
from finray_calib.decide import decide
from finray_calib.decide._capture_errors import require_one_finger
from tests.command_line.records import capture_of, press, sweep, with_known_camera

DESIGN = FingerDesign()


def changed(part, **fields):
    """Return the design with fields of one part changed."""
    return DESIGN.model_copy(update={part: getattr(DESIGN, part).model_copy(update=fields)})


def report_on(design):
    """Return only what the check reads."""
    finger = None if design is None else finger_identity(design)
    return PhotometricErrorReport.model_construct(captured="press 1", finger=finger)


@pytest.mark.parametrize(
    "design",
    [
        DESIGN,
        DESIGN.model_copy(update={"name": "renamed"}),
        changed("light", angle_deg=75.0),
        changed("camera", width_px=1280, height_px=960),
        changed("camera", calibration="lens.yaml"),
    ],
    ids=["same", "name", "angle of the light", "size of the picture", "lens"],
)
def test_what_makes_no_other_finger_is_taken(design):
    assert require_one_finger([sweep()], [report_on(design)]) == ((), (0,))


@pytest.mark.parametrize(
    ("design", "parts"),
    [
        (changed("pad", thickness_mm=4.0), "pad"),
        (changed("light", position_mm=(0.0, -12.0, -1.0)), "light"),
        (changed("light", peak_wavelength_nm=470.0), "light"),
        (changed("indenter", position_mm=20.0), "indenter"),
        (changed("mirror", reflectance=0.5), "mirror"),
        (DESIGN.model_copy(update={"second_light": DESIGN.light}), "second_light"),
    ],
    ids=["pad", "place of the light", "wavelength", "place of the indenter", "mirror", "second light"],
)
def test_another_finger_is_refused_and_both_are_named(design, parts):
    design = design.model_copy(update={"name": "other finger"})
    with pytest.raises(
        DecideError,
        match=rf"on the finger 'other finger', but the sweep 'hill' is on the finger '.*', which differs in {parts},",
    ):
        require_one_finger([sweep()], [report_on(DESIGN), report_on(design)])


def leaves(value, path=""):
    """Return the names of all values of a dumped model."""
    if isinstance(value, dict):
        return [name for key, below in value.items() for name in leaves(below, f"{path}.{key}")]
    return [path]


def test_a_default_that_changes_makes_another_finger(monkeypatch):
    """A value counts by what it is, not by whether it is the default."""
    before = finger_identity(DESIGN)
    thicker = changed("pad", thickness_mm=DESIGN.pad.thickness_mm + 1.0)
    field = type(DESIGN.pad).model_fields["thickness_mm"]
    monkeypatch.setattr(field, "default", thicker.pad.thickness_mm)
    type(DESIGN.pad).model_rebuild(force=True)
    try:
        assert before.differs_in(finger_identity(thicker)) == ("pad",)
    finally:
        monkeypatch.undo()
        type(DESIGN.pad).model_rebuild(force=True)


def test_only_the_first_light_turns_in_a_sweep():
    """The angle of every other panel stays as the design has it, so that another one is another finger."""

    def lit(angle_deg, **others):
        first = DESIGN.light.model_copy(update={"angle_deg": angle_deg})
        return finger_identity(DESIGN.model_copy(update={"light": first, **others}))

    tip, turned = (DESIGN.light.model_copy(update={"angle_deg": angle_deg}) for angle_deg in (150.0, 120.0))
    assert lit(20.0, second_light=tip).differs_in(lit(70.0, second_light=tip)) == ()
    assert lit(20.0, second_light=tip).differs_in(lit(20.0, second_light=turned)) == ("second_light",)
    assert lit(20.0, further_lights=(tip,)).differs_in(lit(20.0, further_lights=(turned,))) == ("further_lights",)


def test_another_version_of_the_identity_is_taken_on_trust():
    older = finger_identity(changed("pad", thickness_mm=4.0)).model_copy(update={"version": 1})
    (note,) = require_one_finger([sweep()], [PhotometricErrorReport.model_construct(captured="press 1", finger=older)])[
        0
    ]
    assert "by the rules of another version of finray" in note
    assert "it was not checked" in note
    # what was stored before there were versions
    assert FingerIdentity(name="finger", depth_mm=1.0, parts={}).version == 1


def test_other_fields_are_another_version():
    """If this fails, fields of the design were added or renamed: raise VERSION, and put the new checksum here."""
    design = DESIGN.model_dump(mode="json")
    fields = sorted(name for part in _PARTS for name in leaves(design[part], part))
    digest = hashlib.sha256("\n".join(fields).encode()).hexdigest()[:12]
    assert (VERSION, digest) == (4, "42d19b0aaf47")


def test_a_report_that_names_no_finger_and_another_depth_are_told():
    (unknown,) = require_one_finger([sweep()], [report_on(None)])[0]
    assert "does not say which finger" in unknown
    (depth,) = require_one_finger([sweep()], [report_on(changed("indenter", depth_mm=0.5))])[0]
    # the depth is that of the design that was rendered; how deep the capture was pressed the report does not say
    assert depth.startswith("the render compared with press 1 was pressed 0.5 mm deep, and the sweep 1.5 mm")


def test_from_a_comparison_to_the_refusal():
    simulated = with_known_camera(press()).model_copy(update={"design": DESIGN})
    report = compare_press(simulated, capture_of(simulated, 50.0), 1)
    assert report.finger == finger_identity(DESIGN)
    assert decide(sweep(), [report], 1).validated
    other = simulated.model_copy(update={"design": changed("pad", thickness_mm=4.0)})
    with pytest.raises(DecideError, match="which differs in pad"):
        decide(sweep(), [compare_press(other, capture_of(other, 50.0), 1)], 1)
