"""A finger pressed by finite elements: the record of the press, and the surfaces that the optics renders."""

from data_schemas.design import FingerDesign
from data_schemas.press_mechanics import PressMechanics
from data_schemas.surfaces import FingerSurfaces
from sim.mechanics.finger_mesh import Preset
from sim.mechanics.press import PressedFinger, contact_distance
from sim.surface_meshes.from_mesh import coat_nodes, shape_from_mesh
from sim.surface_meshes.stored_shape import store_shapes


def press_records(
    design: FingerDesign, pressed: PressedFinger, preset: Preset | None = None
) -> tuple[PressMechanics, FingerSurfaces]:
    """Return forces and surfaces of a press as records.

    Parameters
    ----------
    design, preset
        As they went into :func:`sim.mechanics.press.press_finger`.
    pressed
        What came out.

    Raises
    ------
    SimulateError
        When the pressed gel is torn.
    """
    return _mechanics(design, preset or design.mesh.preset, pressed), _surfaces(design, pressed)


def _mechanics(design: FingerDesign, preset: Preset, pressed: PressedFinger) -> PressMechanics:
    """Return what the press took."""
    gel = design.mechanics.gel
    return PressMechanics(
        name=f"{design.name}, push of {pressed.depth_mm[-1]:g} mm",
        label=f"finite elements, {preset} mesh, {pressed.displacement_mm[0].size} unknowns",
        preset=preset,
        depth_mm=pressed.depth_mm,
        force_n=pressed.force_n,
        energy_n_mm=pressed.energy_n_mm,
        iterations=pressed.iterations,
        largest_pressure_mpa=float(pressed.pressure_mpa.max()),
        unreached=pressed.unreached,
        design=design,
        notes=(
            "frictionless; the indenter is rigid and its distance exact; ribs do not see each other",
            f"gel: C10 = {gel.c10_mpa:g} MPa, K/mu = {gel.bulk_over_shear:g} (the paper gives no K)",
            "dimensions of the skeleton are assumed unless the design's origin says otherwise; forces are unvalidated",
        ),
    )


def _surfaces(design: FingerDesign, pressed: PressedFinger) -> FingerSurfaces:
    """Return the finger without and with contact."""
    mesh = pressed.mesh
    nodes = coat_nodes(design, mesh.nodes_mm, mesh.hexahedra)
    label = f"finite elements, push of {pressed.depth_mm[-1]:g} mm"
    rest = shape_from_mesh(design, mesh.nodes_mm, mesh.hexahedra)
    deformed = shape_from_mesh(
        design,
        mesh.nodes_mm,
        mesh.hexahedra,
        pressed.displacement_mm[-1],
        contact_distance(pressed, nodes),
        label,
    )
    return store_shapes(rest, deformed, f"{design.name}, pressed")
