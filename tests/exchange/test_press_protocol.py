"""The press protocol: solids against closed forms and another reader, presses on the pad, pictures read back."""

import csv
import io

import meshio
import numpy as np
import pytest

from data_schemas import FingerDesign, GelPad, Indenter, PlainSensor, RecordError, TactileCapture
from data_schemas.storage import read_record
from sim.experiments import BACK_MM, press_protocol, protocol_solids
from sim.mechanics import rigid_indenter
from tests.command_line.running import finray, succeed
from tests.exchange.recipe_folders import dome, flat, save

BACK_MM3 = np.pi * 10.0**2 * (BACK_MM[1] - BACK_MM[0])
CUT, DEEP, BORE = 0.3, BACK_MM[0], 2.0


def prismatoid(areas):
    """Volume between parallel faces by Simpson's rule, exact where lengths change evenly: lower, middle, upper area."""
    low, middle, high = areas
    return (low + 4.0 * middle + high) / 6.0


def flat_shape(area, edge_to_middle):
    """A prism of 6 mm whose rim is cut by 0.3 mm at 45 deg."""
    shares = [1.0, 1.0 - CUT / edge_to_middle / 2.0, 1.0 - CUT / edge_to_middle]
    return area * (DEEP - CUT) + CUT * prismatoid([area * share**2 for share in shares])


def pointed(area, half, point=CUT / 2.0):
    """What narrows by 45 deg to a flat."""
    rise = half - point
    return area * (DEEP - rise) + rise * prismatoid([area * (h / half) ** 2 for h in (half, (half + point) / 2, point)])


def ridge():
    rise, length, half = 3.0, 12.0, 3.15
    return length * 2.0 * half * (DEEP - rise) + rise * length * (half + CUT / 2.0)


def rod():
    """The part of a circle between its chords at 60 deg and at the flat."""
    r, length = 3.0, 12.0
    low, high = np.pi / 3.0, np.arcsin(CUT / 2.0 / r)

    def segment(a):
        return r**2 * (a - np.sin(a) * np.cos(a))

    rise = r * (np.cos(high) - np.cos(low))
    return length * (2.0 * r * np.sin(low) * (DEEP - rise) + segment(low) - segment(high))


def dots():
    """Nine caps of a sphere, which rise from a plane that lies deeper by 0.6 of their radius."""
    r = 1.44
    rise = 0.6 * r
    return 144.0 * (DEEP - rise) + 9.0 * np.pi * rise**2 * (3.0 * r - rise) / 3.0


def ring():
    filled = flat_shape(np.pi * 16.0, 4.0)
    hole = np.pi * 4.0 * (BORE - CUT) + np.pi * CUT * prismatoid([4.0, 2.15**2, 2.3**2])
    return filled - hole


VOLUMES_MM3 = {
    "disc": flat_shape(np.pi * 16.0, 4.0),
    "square": flat_shape(64.0, 4.0),
    "triangle": flat_shape(np.sqrt(3.0) / 4.0 * 81.0, 9.0 / np.sqrt(12.0)),
    "hexagon": flat_shape(1.5 * np.sqrt(3.0) * 16.0, 4.0 * np.sqrt(0.75)),
    "ring": ring(),
    "cone": pointed(np.pi * 16.0, 4.0),
    "pyramid": pointed(64.0, 4.0),
    "ridge": ridge(),
    "rod": rod(),
    "dots": dots(),
    "waves": 144.0 * (DEEP - 0.3),
}
CURVED_REL = {"dots": 0.004, "waves": 0.002}
"""Facets of 0.1 mm; the others are polygons of 240 corners, whose area is 1.1e-4 below that of a circle."""


@pytest.mark.parametrize("name", VOLUMES_MM3)
def test_volume_is_that_of_the_closed_form(name):
    solid = next(solid for solid in protocol_solids() if solid.name == name)
    back = BACK_MM3 * polygon_share(solid)
    assert solid.volume_mm3 - back == pytest.approx(VOLUMES_MM3[name], rel=CURVED_REL.get(name, 2e-4))


def polygon_share(solid):
    """Area of the back's outline over that of its circle."""
    rim = solid.vertices_mm[np.isclose(solid.vertices_mm[:, 1], BACK_MM[1])]
    rim = rim[np.hypot(rim[:, 0], rim[:, 2]) > 1.0]
    angle = np.sort(np.arctan2(rim[:, 2], rim[:, 0]))
    return np.sin(np.diff(angle, append=angle[0] + 2.0 * np.pi)).sum() / (2.0 * np.pi)


@pytest.mark.parametrize("extent_mm", [12.0, 4.0])
def test_another_reader_finds_closed_bodies_of_the_stated_height(extent_mm, tmp_path):
    for solid in protocol_solids(extent_mm):
        path = tmp_path / "solid.stl"
        path.write_bytes(solid.stl)
        mesh = meshio.read(path)
        corners, triangles = mesh.points, mesh.cells_dict["triangle"]
        keys = [tuple(corner) for corner in np.round(corners, 6)]
        numbers = {key: k for k, key in enumerate(dict.fromkeys(keys))}
        faces = np.array([numbers[key] for key in keys])[triangles]
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        once = {tuple(edge) for edge in edges}
        assert len(once) == len(edges)
        assert {edge[::-1] for edge in once} == once
        assert (corners[:, 1].min(), corners[:, 1].max()) == (pytest.approx(0.0, abs=1e-6), 14.0)
        top = corners[corners[:, 1] < BACK_MM[0] - 1e-6]
        assert np.abs(top[:, [0, 2]]).max() <= extent_mm / 2.0 + 1e-6


def test_a_finger_takes_each_solid_as_its_indenter_and_is_touched_at_its_plane(tmp_path):
    design = FingerDesign(name="finger")
    for solid in protocol_solids():
        (tmp_path / f"{solid.name}.stl").write_bytes(solid.stl)
        indenter = {"shape": "mesh", "file": f"{solid.name}.stl", "depth_mm": 1.0, "rotation_deg": (0.0, 30.0, 0.0)}
        pressed = FingerDesign.model_validate(design.model_dump() | {"indenter": indenter})
        origin_mm = rigid_indenter(pressed, tmp_path).touching.position_mm
        assert origin_mm[1] == pytest.approx(design.pad.thickness_mm, abs=0.004)


@pytest.mark.parametrize("sensor", [FingerDesign(name="finger"), PlainSensor(name="plain")])
def test_presses_stay_on_the_pad_and_test_what_was_not_taught(sensor):
    protocol = press_protocol(sensor)
    assert [sum(p.purpose == what for p in protocol.presses) for what in ("teach", "test")] == [6, 14]
    taught = {p.diameter_mm for p in protocol.presses if p.purpose == "teach"}
    assert taught.isdisjoint({p.diameter_mm for p in protocol.presses if p.purpose == "test"})
    for press in protocol.presses:
        reach = (press.diameter_mm or protocol.extent_mm) / 2.0
        assert reach <= press.position_mm <= sensor.pad.length_mm - reach
        assert abs(press.across_mm) + reach <= sensor.pad.width_mm / 2.0
        assert 0.0 < press.depth_mm <= min(1.0, 0.2 * sensor.pad.thickness_mm)
    rows = list(csv.DictReader(io.StringIO(protocol.table_csv())))
    assert len(rows) == 2 * len(protocol.presses)
    assert {row["repeat_of"] for row in rows if row["repeat_of"]} == {p.name for p in protocol.presses}


def test_a_small_pad_is_refused_with_the_size_that_is_enough():
    pad = GelPad(length_mm=6.0, width_mm=6.0, thickness_mm=1.0)
    tiny = PlainSensor(name="tiny", pad=pad, indenter=Indenter(shape="ball", radius_mm=1.0, position_mm=3.0))
    with pytest.raises(RecordError, match=r"the pad must be at least 6\.7 mm"):
        press_protocol(tiny)


def test_pictures_taken_by_the_sheet_become_captures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    succeed("design init digit --out digit.toml")
    succeed("export protocol digit.toml --out pictures")
    page = (tmp_path / "pictures" / "protocol.html").read_text(encoding="utf-8")
    assert len(page) < 1_500_000
    # z to the right and x up is the view along -y, from the indenter: x times y is z
    np.testing.assert_array_equal(np.cross([0, 0, 1], [1, 0, 0]), [0, 1, 0])
    assert "seen from the side that is pressed, base on the left" in page
    taken = ("ball-01", "ball-01-again", "ball-07", "ball-08", "solid-01-disc", "solid-09-ridge-again")
    for name in taken:
        folder = tmp_path / "pictures" / name
        save(folder / "contact.png", dome(60.0, 80.0))
        save(folder / "no_contact.png", flat())
        save(
            folder / "repeat_no_contact.png",
            np.maximum(flat(), 1) - (np.indices(flat().shape).sum(0) % 2).astype(np.uint8),
        )
    for kind in ("balls", "solids"):
        assert finray(f"import captures pictures --recipe protocol-{kind} --mm-per-px 0.06 --out {kind}").status == 0
    balls, solids = (
        {path.name.removesuffix(".capture.json"): read_record(path, TactileCapture).indenter for path in found}
        for found in (sorted((tmp_path / kind).glob("*.capture.json")) for kind in ("balls", "solids"))
    )
    assert {**balls, **solids}.keys() == set(taken)
    assert [ball.radius_mm for ball in balls.values()] == [3.0, 3.0, 2.0, 4.0]
    assert {(solid.shape, solid.depth_mm) for solid in solids.values()} == {("mesh", 0.6)}


def test_what_is_no_sensor_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wrong.toml").write_text("kind = 3\n")
    for words in ("protocol", "protocol wrong.toml", "protocol missing.toml", "protocol a.toml b.toml"):
        outcome = finray(f"export {words}")
        assert outcome.status == 2
        assert "Traceback" not in outcome.err
    outcome = finray("export protocol wrong.toml --format csv")
    assert "--format is only for paints; leave it out for a press protocol" in outcome.err
