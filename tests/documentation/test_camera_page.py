"""The page of a camera: every quantity with its uncertainty, the EMVA reference package, and what it lacks."""

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from html_page import Page, assert_stands_alone

from data_schemas import CameraCharacterisation, Resolvable, provenance
from finray_calib.radiometry import characterise_camera, sensitivity_threshold_e
from finray_calib.radiometry._photon_transfer import MONOCHROME, FrameStack, nonuniformity, normal_estimate, root_of
from finray_calib.reports import camera_page
from tests.radiometry.camera_sessions import (
    BLACK_LEVEL_DN,
    GAIN_E_PER_DN,
    READ_NOISE_E,
    SyntheticCameraSession,
    camera_session,
)

HOSTILE = "<script>alert(1)</script>"
ORACLE = Path(__file__).parents[1] / "radiometry" / "oracles" / "emva_reference.py"


def characterised(session: SyntheticCameraSession) -> CameraCharacterisation:
    found = characterise_camera(session.session, session.read)
    return found.model_copy(update={"provenance": provenance("finray radiometry camera-session")})


@pytest.fixture(scope="module")
def camera() -> CameraCharacterisation:
    return characterised(camera_session(np.random.default_rng(1), side_px=96, repeats=14, flicker_rel=0.002))


def numbers(html: str) -> dict:
    block = re.search(r'id="summary">(.*?)</script>', html, re.DOTALL)
    assert block is not None
    return json.loads(block[1])


def test_every_quantity_has_an_expanded_uncertainty(camera):
    html = camera_page(camera)
    page = Page(html)
    assert page.open == []
    assert "The camera model holds" in page.prose
    assert html.index("Verdict") < html.index("<table")
    told = numbers(html)
    assert told["coverage_factor"] == 2.0
    for c in camera.channels:
        channel = told["channels"][c.channel]
        assert len(channel) == 23
        for found in channel.values():
            assert found["expanded_uncertainty"] > 0
        assert channel["dark_noise_e"]["expanded_uncertainty"] == 2 * c.read_noise_e.sd
        assert channel["prnu_percent"]["estimate"] == 100 * c.prnu_rel.estimate
        gain = channel["system_gain_dn_per_e"]
        assert gain["estimate"] * c.gain_e_per_dn.estimate == pytest.approx(1.0, rel=1e-12)
        assert gain["expanded_uncertainty"] / gain["estimate"] == pytest.approx(
            2 * c.gain_e_per_dn.sd / c.gain_e_per_dn.estimate, rel=1e-12
        )
        decibels = channel["dynamic_range_db"]
        assert 10 ** (decibels["estimate"] / 20) == pytest.approx(c.dynamic_range.estimate, rel=1e-12)
        steps = 20 * np.log10(1 + 2e-4 * c.dynamic_range.sd / c.dynamic_range.estimate) / 1e-4
        assert decibels["expanded_uncertainty"] == pytest.approx(steps, rel=1e-3)


def test_the_interval_of_an_offset_in_electrons_holds_the_uncertainty_of_the_gain(camera):
    """DSNU times gain, both drawn: 1e6 draws tell an end to 0.2 % of the half width."""
    channel = camera.channels[0]
    gain = normal_estimate(channel.gain_e_per_dn.estimate, 0.05 * channel.gain_e_per_dn.estimate)
    dsnu = normal_estimate(channel.dsnu_dn.estimate, 0.02 * channel.dsnu_dn.estimate)
    known = Resolvable(resolved=True, **dsnu.model_dump())
    unsure = camera.model_copy(
        update={"channels": (channel.model_copy(update={"gain_e_per_dn": gain, "dsnu_dn": known}),)}
    )
    told = numbers(camera_page(unsure))["channels"][channel.channel]["dsnu_e"]
    rng = np.random.default_rng(1)
    drawn = rng.normal(gain.estimate, gain.sd, 10**6) * rng.normal(dsnu.estimate, dsnu.sd, 10**6)
    half = 0.5 * float(np.diff(np.quantile(drawn, (0.025, 0.975)))[0])
    # the product of two normal values is not quite normal: its ends lie 0.1 % of the value apart from ours
    assert 0.5 * (told["high95"] - told["low95"]) == pytest.approx(half, rel=0.01)
    assert told["expanded_uncertainty"] == pytest.approx(2.0 * float(drawn.std()), rel=0.01)


def test_the_threshold_is_that_of_the_standard_and_its_uncertainty_covers():
    rng = np.random.default_rng(2)
    truth_e = np.hypot(READ_NOISE_E, GAIN_E_PER_DN / np.sqrt(12)) + 0.5
    gain = characterised(camera_session(rng)).channels[0].gain_e_per_dn
    gains = GAIN_E_PER_DN + gain.sd * rng.standard_normal(2000)
    noises_dn = READ_NOISE_E / GAIN_E_PER_DN + 0.05 * rng.standard_normal(2000)
    estimates = [
        sensitivity_threshold_e(
            gain.model_copy(update={"estimate": g}), gain.model_copy(update={"estimate": n, "sd": 0.05})
        )
        for g, n in zip(gains, noises_dn, strict=True)
    ]
    covered = np.mean([e.low95 <= truth_e <= e.high95 for e in estimates])
    assert abs(covered - 0.95) < 4 * np.sqrt(0.05 * 0.95 / 2000)


def test_what_was_not_measured_is_said(camera):
    prose = Page(camera_page(camera)).prose
    for words in ("Quantum efficiency", "known irradiance", "There are no spectrograms", "every second row",
                  "rig's own lamp", "temperature of the sensor"):  # fmt: skip
        assert words in prose


def test_a_record_of_an_older_version_says_that_rows_and_columns_are_not_measured(camera):
    lost = dict.fromkeys(("dsnu_rows_dn", "dsnu_columns_dn", "dsnu_pixels_dn", "prnu_rows_rel", "prnu_columns_rel"))
    old = camera.model_copy(update={"channels": tuple(c.model_copy(update=lost) for c in camera.channels)})
    html = camera_page(old)
    assert "Rows, columns and pixels are not separated" in Page(html).prose
    assert html.count("not measured") == 5 * len(camera.channels)
    assert numbers(html)["channels"]["red"]["dsnu_rows_dn"] is None


def test_a_channel_that_does_not_saturate_says_so():
    dim = characterised(camera_session(np.random.default_rng(4), light=(1.0, 1.0, 0.4)))
    html = camera_page(dim)
    assert "The camera model holds, with remarks" in html
    assert numbers(html)["channels"]["blue"]["dynamic_range_db"] is None
    assert "not reached" in html
    assert "blue: no exposure saturates" in html


def test_a_bent_camera_is_named():
    def bend(frame, counts):
        signal = counts.astype(float) - BLACK_LEVEL_DN
        return np.rint(np.clip(signal * (1 - 0.15 * signal / 3500) + BLACK_LEVEL_DN, 0, 4095)).astype(np.uint16)

    html = camera_page(characterised(camera_session(np.random.default_rng(5), side_px=128, repeats=2).change(bend)))
    assert "departs from a line through exposure by" in html
    assert "The camera model holds</" not in html


def test_what_is_not_resolved_is_a_limit(camera):
    page = camera_page(camera)
    for c in camera.channels:
        assert not c.linearity_error_rel.resolved
        assert f"below {100 * c.linearity_error_rel.high95:.2g}" in page
    unresolved = [v for c in camera.channels for _, v in c if isinstance(v, Resolvable) and not v.resolved]
    assert page.count("below ") >= len(unresolved)


def test_names_stay_text_and_the_page_stands_alone(camera):
    hostile = camera.model_copy(update={"camera_name": HOSTILE, "notes": (HOSTILE,), "filter_name": HOSTILE})
    html = camera_page(hostile)
    assert HOSTILE not in html
    assert_stands_alone(html)
    assert html == camera_page(hostile)
    page = Page(html)
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert len(page.all("caption")) == len(page.all("table")) > 3


def emva(session: SyntheticCameraSession, folder: Path) -> dict[str, float]:
    """Return what the EMVA reference package says of the red pixels of a session."""
    lost = [name for name in ("emva1288", "lxml", "PIL") if importlib.util.find_spec(name) is None]
    if lost:
        pytest.skip(f"NOT CHECKED against the EMVA package: pip install {' '.join(lost)}")
    stacks: dict[float, dict[str, list[str]]] = {}
    for number, frame in enumerate(session.session.frames):
        np.save(folder / f"{number}.npy", session.read(frame)[0::2, 0::2])
        stacks.setdefault(frame.exposure_s, {}).setdefault(frame.frame_type, []).append(f"{number}.npy")
    both = {exposure_s: stack for exposure_s, stack in stacks.items() if len(stack) == 2}  # the long dark ones lack lit
    most_s = max(both, key=lambda exposure_s: len(both[exposure_s]["white"]))

    def listed(exposure_s: float, most: int) -> dict[str, dict[str, list[str]]]:
        photons = {"white": f"{5e5 * exposure_s:.6f}", "dark": "0.000000"}
        return {f"{1e9 * exposure_s:.1f}": {photons[kind]: names[:most] for kind, names in both[exposure_s].items()}}

    temporal = {time: found for exposure_s in both for time, found in listed(exposure_s, 2).items()}
    images = {"temporal": temporal, "spatial": listed(most_s, 1000)}
    (folder / "images.json").write_text(json.dumps(images))
    done = subprocess.run([sys.executable, ORACLE, folder], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_the_numbers_of_the_page_are_those_of_the_emva_package(tmp_path):
    session = camera_session(np.random.default_rng(7), side_px=256, flicker_rel=0.002)
    theirs = emva(session, tmp_path)
    camera = characterised(session)
    ours = numbers(camera_page(camera))["channels"]["red"]

    def differs(name: str, their_name: str) -> float:
        """Return the difference in standard uncertainties of ours."""
        return 2 * abs(ours[name]["estimate"] - theirs[their_name]) / ours[name]["expanded_uncertainty"]

    # its line has no weights: its standard deviation is about 1.5 times ours, and the frames are the same
    for name, their_name in (("system_gain_dn_per_e", "k_dn_per_e"), ("dark_noise_e", "sigma_d_e"),
                             ("sensitivity_threshold_e", "threshold_e")):  # fmt: skip
        assert differs(name, their_name) < 4 * 1.5
        assert ours[name]["expanded_uncertainty"] < 0.02 * ours[name]["estimate"]
    # it takes the photons of the level with the largest variance, we the counts, where the first pixels clip
    for name in ("saturation_capacity_e", "snr_max_db", "dynamic_range_db"):
        assert differs(name, name) < 2
    # only rounding in its names of exposures is left
    red = camera.channels[0]
    assert 100 * red.linearity_lowest_rel == pytest.approx(theirs["lowest_percent"], abs=1e-4)
    assert 100 * red.linearity_highest_rel == pytest.approx(theirs["highest_percent"], abs=1e-4)
    assert red.linearity_highest_rel - red.linearity_lowest_rel > 1e-3


def test_the_non_uniformities_of_the_page_are_those_of_the_emva_package(tmp_path):
    session = camera_session(np.random.default_rng(8), side_px=128, repeats=14)
    theirs = emva(session, tmp_path)
    ours = numbers(camera_page(characterised(session)))["channels"]["red"]
    # it leaves the flicker of the frame mean in the temporal variance: 1/4096 of it, 16 frames
    assert ours["flat_nonuniformity_percent"]["estimate"] == pytest.approx(theirs["prnu_percent"], rel=1e-3)
    assert ours["dsnu_dn"]["estimate"] == pytest.approx(theirs["dsnu_e"] * theirs["k_dn_per_e"], rel=1e-3)


ROW_SD_DN, COLUMN_SD_DN, ROW_GAIN_SD, COLUMN_GAIN_SD = 3.0, 2.0, 0.02, 0.03


def striped(session: SyntheticCameraSession, rng: np.random.Generator, side_px: int) -> SyntheticCameraSession:
    """Give every row and column an offset and a response of its own."""
    row_dn, column_dn = ROW_SD_DN * rng.standard_normal(side_px), COLUMN_SD_DN * rng.standard_normal(side_px)
    row_gain, column_gain = ROW_GAIN_SD * rng.standard_normal(side_px), COLUMN_GAIN_SD * rng.standard_normal(side_px)

    def stripe(frame, counts):
        gain = 1.0 + row_gain[:, None] + column_gain
        signal = (counts - BLACK_LEVEL_DN) * (gain if frame.frame_type == "white" else 1.0)
        return np.rint(np.clip(signal + BLACK_LEVEL_DN + row_dn[:, None] + column_dn, 0, 4095)).astype(np.uint16)

    return session.change(stripe)


def test_rows_columns_and_pixels_of_the_page_are_those_of_the_emva_package(tmp_path):
    rng = np.random.default_rng(9)
    session = striped(camera_session(rng, side_px=128, repeats=14), rng, 128)
    theirs = emva(session, tmp_path)
    ours = numbers(camera_page(characterised(session)))["channels"]["red"]
    # its factors differ by terms of the order 1 / 64, the number of rows and columns of a channel here
    for name, part in (("rows", "row"), ("columns", "col"), ("pixels", "pixel")):
        their_dn = theirs[f"dsnu_{part}_e"] * theirs["k_dn_per_e"]
        assert ours[f"dsnu_{name}_dn"]["estimate"] == pytest.approx(their_dn, rel=1 / 64)
    # it takes no high-pass; both estimate the same of independent rows, with some 10 % each
    for name, part in (("rows", "row"), ("columns", "col")):
        found, their_percent = ours[f"prnu_{name}_percent"], theirs[f"prnu_{part}_percent"]
        assert abs(found["estimate"] - their_percent) < 2 * found["expanded_uncertainty"]
    assert ours["prnu_percent"]["estimate"] == pytest.approx(theirs["prnu_pixel_percent"], rel=0.1)


def test_intervals_of_rows_and_columns_hold_the_truth():
    """With the rows and columns of a small region: where the truth is resolved and where there is nothing."""
    rng = np.random.default_rng(10)
    runs = 150
    held, empty = dict.fromkeys(("rows", "columns", "row_to_row", "column_to_column"), 0), 0
    truth = {"rows": ROW_SD_DN, "columns": COLUMN_SD_DN, "row_to_row": ROW_SD_DN, "column_to_column": COLUMN_SD_DN}
    for _ in range(runs):
        fixed = ROW_SD_DN * rng.standard_normal((96, 1)) + COLUMN_SD_DN * rng.standard_normal((1, 128))
        for pattern in (fixed, 0.0):
            stack = FrameStack("a test", [MONOCHROME], 65535)
            for _ in range(3):
                stack.add(1000.0 + pattern + 8.0 * rng.standard_normal((96, 128)))
            (found,) = stack.statistics()
            if pattern is fixed:
                for kind in held:
                    variance = nonuniformity(found, None, kind)
                    told = root_of(variance.variance_dn2, variance.sd_dn2)
                    held[kind] += told.low95 <= truth[kind] <= told.high95
            else:
                rows = nonuniformity(found, None, "rows")
                empty += not root_of(rows.variance_dn2, rows.sd_dn2).resolved
    # a variance of 96 rows is not quite normal: 95 % becomes 93 to 94 %
    for kind, number in held.items():
        assert abs(number / runs - 0.94) < 4 * np.sqrt(0.06 * 0.94 / runs), (kind, number)
    assert empty / runs > 0.975 - 4 * np.sqrt(0.025 * 0.975 / runs)


def test_light_that_darkens_towards_a_corner_is_no_noise_of_rows():
    rng = np.random.default_rng(11)
    y, x = np.mgrid[0:240, 0:320] / np.array([240.0, 320.0])[:, None, None]
    stack = FrameStack("a test", [MONOCHROME], 65535)
    pattern = 1000.0 * (1.0 - 0.15 * x * y) + rng.standard_normal((240, 1))
    for _ in range(3):
        stack.add(pattern + 3.0 * rng.standard_normal((240, 320)))
    variance = nonuniformity(stack.statistics()[0], None, "row_to_row")
    # of 240 rows, after second differences some 13 %
    assert variance.variance_dn2 == pytest.approx(1.0, abs=4 * 0.13)
    assert variance.sd_dn2 < 0.3
