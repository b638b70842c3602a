"""What records say of themselves, and their methods: quantities, draws through a function, plots, data sets."""

import copy
import pickle
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from typing import Annotated
from unittest import mock

import numpy as np
import pytest
from numpy.typing import NDArray

import finray_calib as finray
from data_schemas import (
    ArraySpec,
    Estimate,
    MissingExtraError,
    Model,
    PaintPlan,
    PixelSignals,
    Quantity,
    RecordError,
    RegionOfInterest,
    SensedPress,
    TwoLights,
)
from data_schemas.json_schemas import STORED
from data_schemas.storage import read_record
from finray_calib.exchange._record_formats import _dims
from tests.command_line.records import capture_of, press, sweep
from tests.documentation.example_records import example_decision, example_results
from tests.schemas.freeze import FROZEN

MODE = Estimate(estimate=598.14, sd=4.2, low68=594.0, high68=602.0, low95=586.53, high95=603.52)


@pytest.fixture(scope="module")
def results():
    return example_results()


@pytest.fixture(scope="module")
def example(results):
    return results.paints["red"].calibration


@pytest.fixture(scope="module")
def records(results):
    red = results.paints["red"]
    return [red.calibration, red.bands, red.session, results.press, results.capture, results.report, results.sweep,
            results.decision, finray.finger_design()]  # fmt: skip


def test_a_quantity_reads_as_in_a_paper():
    assert str(Quantity.of(MODE, "nm")) == repr(Quantity.of(MODE, "nm")) == "598.1 [586.5, 603.5] nm"
    assert str(MODE) == repr(MODE) == "598.1 [586.5, 603.5]"


def test_quantities_of_a_paint(example):
    assert example.mode_nm.estimate == example.parameters["mode_nm"].estimate
    for quantity, unit in ((example.mode_nm, " nm"), (example.fwhm_nm, " nm"), (example.peak_per_nm, " 1/nm"),
                           (example.stokes_shift_nm, " nm"), (example.reflectance_at_laser, "]")):  # fmt: skip
        assert str(quantity).endswith(unit)


def test_every_record_is_told_in_a_few_lines(records):
    for record in records:
        for text in (repr(record), str(record)):
            lines = text.splitlines()
            assert lines[0].startswith(type(record).__name__)
            assert len(lines) <= 10
            assert max(map(len, lines)) <= 120
            assert "array([" not in text


def test_the_text_of_a_paint_holds_its_numbers_and_sizes(example):
    text = repr(example)
    assert f"mode_nm: {example.mode_nm}" in text
    assert "draws 400 x 6" in text
    assert "made:" not in text
    assert len(repr(example.reradiation)) < 2000  # a part of a record shows the sizes of its arrays, too


def test_html_is_escaped_and_text_keeps_the_terminal_whole(example):
    named = example.model_copy(update={"paint_name": "<script>alert(1)</script>\x1b[31m\nred", "spectrum_from": "a<b"})
    html = named._repr_html_()
    assert "<script>" not in html
    assert "a&lt;b" in html
    ElementTree.fromstring(html)
    assert "\x1b" not in repr(named)
    assert len(repr(named).splitlines()) == len(repr(example).splitlines())


def test_draws_go_through_a_function_of_the_user(example):
    yields = example.propagate(lambda emission_per_nm: np.trapezoid(emission_per_nm, example.wavelength_nm))
    by_hand = np.trapezoid(example.emission_draws_per_nm, example.wavelength_nm, axis=1)
    np.testing.assert_allclose(yields.draws, by_hand)
    assert yields.low95 < yields.estimate < yields.high95
    assert yields.sd == pytest.approx(by_hand.std(ddof=1))
    assert str(yields) == str(yields.as_estimate())
    rgb = example.propagate(lambda emission_per_nm: emission_per_nm[:3])
    assert rgb.estimate.shape == rgb.low95.shape == rgb.sd.shape == (3,)
    assert repr(rgb) == "PropagatedDraws: 40 draws of shape (3,); see estimate, low95, high95"
    with pytest.raises(RecordError, match=r"must be one number, .* shape \(3,\); use estimate"):
        rgb.as_estimate()


def test_a_function_that_gives_no_numbers_is_refused(example):
    with pytest.raises(RecordError, match=r"expected a function of an emission, .*, got int"):
        example.propagate(3)
    with pytest.raises(RecordError, match="NaN or an infinite value for 40 of 40 draws"):
        example.propagate(lambda emission_per_nm: float("nan"))
    with pytest.raises(RecordError, match="array of the same shape, for every draw"):
        example.propagate(lambda emission_per_nm: np.arange(int(1e6 * emission_per_nm.max()) % 97))
    with pytest.raises(RecordError, match="must return a number"):
        example.propagate(lambda emission_per_nm: "red")


def test_records_are_drawn(results, example, tmp_path):
    drawn = {
        ".svg": (example, results.paints["red"].bands, results.report, results.sweep, results.decision),
        ".png": (results.press, results.capture, capture_of(press(), 50.0), finray.finger_design()),
    }
    for suffix, some in drawn.items():
        for number, record in enumerate(some):
            plot = record.plot()
            path = plot.save(tmp_path / f"{number}{suffix}")
            assert path.read_bytes() == plot.content
            assert path.read_bytes().startswith({".svg": b"<?xml", ".png": b"\x89PNG"}[suffix])
            ((kind, shown),) = plot._repr_mimebundle_().items()
            assert kind == {".svg": "image/svg+xml", ".png": "image/png"}[suffix]
            assert shown
    assert "save(path)" in repr(plot)
    with pytest.raises(RecordError, match=r"the name must end in \.png, because this drawing is PNG"):
        plot.save(tmp_path / "plot.pdf")
    with pytest.raises(RecordError, match=r"0\.png.*exists"):
        plot.save(tmp_path / "0.png")
    plan = PaintPlan(paint_name="red", region=RegionOfInterest(row_px=0, column_px=0, height_px=8, width_px=8))
    with pytest.raises(RecordError, match="kind PaintPlan cannot be drawn; these kinds can: BandSignals, FingerDesign"):
        plan.plot()


def test_arrays_have_names_and_units_in_xarray(results, example):
    data = example.to_xarray()
    assert data["emission_per_nm"].dims == ("wavelength",)
    assert data["wavelength_nm"].attrs["units"] == "nm"
    assert data["emission_per_nm"].attrs["units"] == data["emission_high95_per_nm"].attrs["units"] == "1/nm"
    assert data["measured"].sel(channel="green").dims == ("filter",)
    np.testing.assert_array_equal(data["draws"], example.draws)
    assert data.attrs["paint_name"] == "fluorescent red"
    probes = sweep().to_xarray()
    assert probes["probe_points_mm"].dims == ("probe", "axis")
    assert list(probes["axis"].values) == ["x", "y", "z"]
    assert _dims(("hexahedron", "3", "3"), (8, 3, 3), "modes_mm", "mm") == ("hexahedron", "axis_3", "axis")
    assert "angles_deg" in probes.coords
    assert example_decision("tie").to_xarray().coords["grid_deg"].size == 121
    assert results.capture.to_xarray()["repeat_no_contact"].dims == results.capture.to_xarray()["contact"].dims
    with pytest.raises(RecordError, match=r"record \(FingerDesign\) has no array"):
        finray.finger_design().to_xarray()


def frozen(record_type):
    """The stored example of the newest version of a kind."""
    newest = max((FROZEN / record_type.__name__).iterdir(), key=lambda folder: int(folder.name[1:]))
    return read_record(newest / "example.json", record_type)


@pytest.mark.parametrize("record_type", STORED)
def test_every_stored_record_goes_to_xarray_or_has_no_array(record_type):
    record = frozen(record_type)
    arrays = {name for name in record_type.model_fields if isinstance(getattr(record, name), np.ndarray)}
    if not arrays:
        with pytest.raises(RecordError, match="has no array"):
            record.to_xarray()
        return
    data = record.to_xarray()
    assert arrays <= data.variables.keys()
    for name in arrays:
        np.testing.assert_array_equal(data[name], getattr(record, name))


def test_dimensions_are_named_after_what_lies_along_them():
    pixels, lights, sensed = map(frozen, (PixelSignals, TwoLights, SensedPress))
    data = pixels.to_xarray()  # whose own field "channel" is the channel of each pixel
    assert data["channel"].dims == ("row", "column")
    assert data["common_sd_rel"].sel(channel_axis="green").dims == ("filter",)
    assert list(lights.to_xarray()["channel"].values) == list(lights.channels)
    assert sensed.to_xarray()["normal"].dims == ("row", "column", "axis")


def test_a_paint_goes_to_arviz(example):
    arviz = pytest.importorskip("arviz")
    data = example.to_inferencedata()
    assert set(data.groups()) >= {"posterior", "prior", "posterior_predictive", "observed_data"}
    median = float(data["posterior"][example.sampled[0]].median())
    assert median == pytest.approx(float(np.median(example.draws[:, 0])))
    assert len(arviz.summary(data, kind="stats")) == len(example.sampled)


def test_what_is_missing_for_an_export_is_named(example, monkeypatch):
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(MissingExtraError, match="to_inferencedata needs ArviZ"):
        example.to_inferencedata()
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(MissingExtraError, match="to_xarray needs xarray"):
        example.to_xarray()


def test_the_ground_alone_says_where_its_methods_come_from():
    code = "from data_schemas import FingerDesign; FingerDesign().plot()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "FingerDesign.plot() is part of the package finray_calib, which is not imported; write" in done.stderr


def test_records_with_arrays_are_compared(lab, paint):
    again = finray.read_record(lab / "red.paint.json")
    assert paint == again
    assert paint in [again]
    other = paint.draws.copy()
    other[0, 0] += 1e-9
    assert paint != paint.model_copy(update={"draws": other})
    assert paint != paint.model_copy(update={"draws": other[:-1]})
    assert paint != paint.draws.tolist()
    with_nan = paint.model_copy(update={"draws": np.where(other > 0, other, np.nan)})
    assert with_nan == with_nan.model_copy(update={"draws": with_nan.draws.copy()})
    assert len({MODE, MODE.model_copy()}) == 1  # what holds no arrays is still hashed


def test_equality_is_that_of_values(paint):
    class Numbers(Model):
        values: tuple[float, ...] = ()
        image: Annotated[NDArray[np.float64], ArraySpec("<f8", ("row", "column"))] | None = None

    gap = Numbers(values=(1.0, float("nan")))
    assert gap == Numbers(values=(1.0, float("nan")))
    assert hash(gap) == hash(Numbers(values=(1.0, float("nan"))))
    assert gap != Numbers(values=(float("nan"), 1.0))
    assert Numbers(image=np.zeros((0, 3))) != Numbers()
    assert Numbers(image=np.zeros((0, 3))) != Numbers(image=np.zeros((0, 2)))
    assert paint == mock.ANY  # another type is asked too
    assert paint.__eq__(1) is NotImplemented
    assert {paint: "red"}[paint.model_copy()] == "red"


def test_copies_and_what_another_process_sends_stay_as_they_are(paint):
    for copied in (copy.deepcopy(paint), pickle.loads(pickle.dumps(paint)), paint.model_copy(deep=True)):
        assert copied == paint
        with pytest.raises(ValueError, match="read-only"):
            copied.draws[0, 0] = 1.0


def test_long_records_are_compared_at_the_speed_of_tuples():
    """A million numbers: 4 times the interpreter's own comparison; entry by entry it was 200 times."""

    class Numbers(Model):
        values: tuple[float, ...]

    long, again = (Numbers(values=tuple(map(float, range(1_000_000)))) for _ in range(2))
    start = time.process_time()
    assert long.values == again.values
    alone = time.process_time() - start
    assert long == again
    assert time.process_time() - start < 31.0 * alone
