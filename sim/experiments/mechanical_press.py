"""A finger pressed by finite elements: the record of the press, and the surfaces that the optics renders."""

from dataclasses import replace

import numpy as np

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.press_mechanics import PressIncrement, PressMechanics, PressSensitivities
from data_schemas.surfaces import FingerSurfaces
from sim.mechanics.finger_mesh import Preset, finger_mesh
from sim.mechanics.press import PressedFinger, contact_distance
from sim.surface_meshes.from_mesh import coat_nodes, shape_from_mesh
from sim.surface_meshes.stored_shape import store_shapes


def press_records(
    design: FingerDesign,
    pressed: PressedFinger,
    preset: Preset | None = None,
    engine: str = "finite elements",
    notes: tuple[str, ...] = (),
    sensitivities: PressSensitivities | None = None,
) -> tuple[PressMechanics, FingerSurfaces]:
    """Return forces and surfaces of a press as records.

    Parameters
    ----------
    design, preset
        As they went into :func:`sim.mechanics.press.press_finger`.
    pressed
        What came out.
    engine
        Program that pressed, for the label.
    notes
        What must be said about it beside what holds for every press.
    sensitivities
        The same press of the design with one number changed, if there are.

    Raises
    ------
    SimulateError
        When the pressed gel is torn.
    """
    mechanics = _mechanics(design, preset or design.mesh.preset, pressed, engine, notes)
    mechanics = mechanics.model_copy(update={"sensitivities": sensitivities})
    return mechanics, _surfaces(design, pressed, engine)


def increment_record(design: FingerDesign, pressed: PressedFinger, preset: Preset | None = None) -> PressIncrement:
    """Return the last increment of a press as a record to go on from."""
    return PressIncrement(
        preset=preset or design.mesh.preset,
        depth_mm=pressed.depth_mm,
        force_n=pressed.force_n,
        energy_n_mm=pressed.energy_n_mm,
        iterations=pressed.iterations,
        nodes_mm=pressed.mesh.nodes_mm,
        displacement_mm=pressed.displacement_mm[-1],
        modes_mm=np.concatenate([modes for modes in pressed.modes_mm if modes.shape[1]]),
        design=design,
    )


def stored_press(record: PressIncrement, design: FingerDesign) -> PressedFinger:
    """Return a stored increment as a press of a design, which may push deeper, to go on from.

    Raises
    ------
    SimulateError
        When the design differs in more than the depth of its push.
    """
    depth = {"depth_mm": design.indenter.depth_mm}
    before = record.design.model_copy(update={"indenter": record.design.indenter.model_copy(update=depth)})
    # a stored design carries its own provenance
    other = [
        name
        for name in type(design).model_fields
        if name != "provenance" and getattr(before, name) != getattr(design, name)
    ]
    if other or record.preset != design.mesh.preset:
        raise SimulateError(
            f"the stored increment is of a press of another design: it differs in {', '.join(other) or 'mesh'}; only "
            "indenter.depth_mm may change between an increment and what goes on from it"
        )
    mesh = finger_mesh(design, record.preset)
    own = len(mesh.nodes_mm)
    # a barrier's indenter is one node more
    if len(record.nodes_mm) not in {own, own + 1} or not np.array_equal(record.nodes_mm[:own], mesh.nodes_mm):
        raise SimulateError(
            "the stored increment is of another mesh of this design, made by another version; press from the start"
        )
    with_modes = [block.element == "incompatible_modes" for block in mesh.blocks]
    sizes = [len(block.hexahedra) if has else 0 for block, has in zip(mesh.blocks, with_modes, strict=True)]
    parts = np.split(record.modes_mm, np.cumsum(sizes)[:-1])
    nothing = np.empty((0, 0))
    return PressedFinger(
        mesh=replace(mesh, nodes_mm=record.nodes_mm),
        depth_mm=record.depth_mm,
        force_n=record.force_n,
        energy_n_mm=record.energy_n_mm,
        displacement_mm=record.displacement_mm[None],
        iterations=record.iterations,
        modes_mm=tuple(
            part if has else np.zeros((len(block.hexahedra), 0, 3))
            for part, has, block in zip(parts, with_modes, mesh.blocks, strict=True)
        ),
        pressure_mpa=nothing,
        touch_mm=nothing,
        unreached="",
        contact="",
    )


def _mechanics(
    design: FingerDesign, preset: Preset, pressed: PressedFinger, engine: str, notes: tuple[str, ...]
) -> PressMechanics:
    """Return what the press took."""
    gel = design.mechanics.gel
    return PressMechanics(
        name=f"{design.name}, push of {pressed.depth_mm[-1]:g} mm",
        label=f"{engine}, {preset} mesh, {pressed.displacement_mm[0].size} unknowns",
        preset=preset,
        depth_mm=pressed.depth_mm,
        force_n=pressed.force_n,
        energy_n_mm=pressed.energy_n_mm,
        iterations=pressed.iterations,
        largest_pressure_mpa=float(pressed.pressure_mpa.max()),
        unreached=pressed.unreached,
        design=design,
        notes=(
            pressed.contact,
            f"gel: C10 = {gel.c10_mpa:g} MPa, K/mu = {gel.bulk_over_shear:g} (the paper gives no K)",
            "dimensions of the skeleton are assumed unless the design's origin says otherwise; forces are unvalidated",
            *notes,
        ),
    )


def _surfaces(design: FingerDesign, pressed: PressedFinger, engine: str) -> FingerSurfaces:
    """Return the finger without and with contact."""
    mesh = pressed.mesh
    nodes = coat_nodes(design, mesh.nodes_mm, mesh.hexahedra)
    label = f"{engine}, push of {pressed.depth_mm[-1]:g} mm"
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
