"""A finger pressed by finite elements: records of a press or a grasp, and the surfaces that the optics renders."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    ContactKind,
    FingerDesign,
    FingerSurfaces,
    ObjectGrasp,
    Preset,
    PressIncrement,
    PressMechanics,
    PressMotion,
    PressSensitivities,
    Rubber,
    SimulateError,
)
from sim.mechanics import (
    FORCE_EXCESS_REL,
    ContactChoice,
    ContactMotion,
    FingerMesh,
    Grasp,
    GraspTask,
    PenaltyContact,
    PressedFinger,
    RigidIndenter,
    chord_shortfall_rel,
    chosen_contact,
    coat_points,
    contact_distance,
    contact_forces_n,
    face_points,
    finger_mesh,
    frictionless_torque_n_mm,
    rigid_indenter,
    slip_torque_n_mm,
    touch_areas_mm2,
)
from sim.surface_meshes import coat_nodes, shape_from_mesh, store_shapes


def press_records(
    design: FingerDesign,
    pressed: PressedFinger,
    preset: Preset | None = None,
    engine: str = "finite elements",
    notes: tuple[str, ...] = (),
    sensitivities: PressSensitivities | None = None,
    wanted_force_n: float | None = None,
) -> tuple[PressMechanics, FingerSurfaces]:
    """Return forces and surfaces of a press as records.

    Parameters
    ----------
    design, preset
        As they went into :func:`sim.mechanics.press_finger`.
    pressed
        What came out.
    engine
        Program that pressed, for the label.
    notes
        What must be said about it beside what holds for every press.
    sensitivities
        The same press of the design with one number changed, if there are.
    wanted_force_n
        Of a press to a force.

    Raises
    ------
    SimulateError
        When the pressed gel is torn.
    """
    mechanics = _mechanics(design, preset or design.mesh.preset, pressed, engine, notes)
    mechanics = mechanics.model_copy(update={"sensitivities": sensitivities, "wanted_force_n": wanted_force_n})
    return mechanics, _surfaces(design, pressed, engine)


def grasp_record(design: FingerDesign, task: GraspTask, grasp: Grasp) -> ObjectGrasp:
    """Return a grasp as a record.

    Parameters
    ----------
    design, task
        As they went into :func:`sim.mechanics.grasp_object`.
    grasp
        What came out.
    """
    mesh = design.mesh.preset
    return ObjectGrasp(
        name=design.name,
        label=f"finite elements, {mesh} mesh, two fingers close with {grasp.force_n[-1]:.3g} N",
        preset=mesh,
        design=design,
        wanted_force_n=task.force_n,
        mass_kg=task.mass_kg,
        weight_n=task.weight_n,
        down=task.down,
        closing_mm=grasp.closing_mm,
        closing_force_n=grasp.force_n,
        carried_n=grasp.weight_n,
        moves_mm=grasp.moves_mm,
        turns_deg=grasp.turns_deg,
        unbalanced_n=grasp.unbalanced_n,
        stiffness_n_per_mm=grasp.stiffness_n_per_mm,
        lost=grasp.lost,
        notes=(
            grasp.near.contact,
            "the object is rigid and of uniform density; the jaws are rigid, and nothing else touches the object; the "
            "least resistance to a move is computed with the friction limits of the last increment",
        ),
    )


def increment_record(
    design: FingerDesign, pressed: PressedFinger, preset: Preset | None = None, indenter_sha256: str | None = None
) -> PressIncrement:
    """Return the last increment of a press as a record to continue from; with the digest of a mesh indenter's STL."""
    by_points = pressed.kind == "penalty" and pressed.touch_mm.size > 0
    coat_mm = pressed.mesh.nodes_mm[pressed.mesh.surfaces["coat"]]
    return PressIncrement(
        preset=preset or design.mesh.preset,
        depth_mm=pressed.depth_mm,
        force_n=pressed.force_n,
        energy_n_mm=pressed.energy_n_mm,
        contact_energy_n_mm=pressed.contact_energy_n_mm,
        friction_work_n_mm=pressed.friction_work_n_mm,
        contact=None if pressed.kind == "unknown" else pressed.kind,
        indenter_sha256=indenter_sha256,
        iterations=pressed.iterations,
        nodes_mm=pressed.mesh.nodes_mm,
        displacement_mm=pressed.displacement_mm[-1],
        modes_mm=np.concatenate([modes for modes in pressed.modes_mm if modes.shape[1]]),
        unstable=pressed.unstable,
        parts_touch_from_mm=pressed.parts_touch_from_mm,
        points_per_side=math.isqrt(pressed.touch_mm.shape[1]) if by_points else None,
        points_on_border=math.isclose(pressed.touch_mm[..., 2].max(), coat_mm[..., 2].max()) if by_points else None,
        design=design,
    )


def stored_press(
    record: PressIncrement,
    design: FingerDesign,
    contact: ContactChoice = "auto",
    indenter_sha256: str | None = None,
    folder: Path = Path(),
) -> PressedFinger:
    """Return a stored increment as a press of a design, which may push deeper, to continue from.

    What an increment of an older version does not tell (its contact, the digest of the STL) is taken as the same, but
    for the points where the penalty acts.

    Parameters
    ----------
    record
        The increment.
    design, contact
        As they go into :func:`sim.mechanics.press_finger` now.
    indenter_sha256
        Digest of the STL of a mesh indenter, as it is now.
    folder
        Where the design stands: the STL of an indenter is relative to it.

    Raises
    ------
    SimulateError
        When the design differs in more than the depth of its push, its STL or the contact is another one, or the
        contact acted at other points of the coat and that changes the forces.
    """
    _check_same_design(record, design)
    # a press that took the barrier by itself goes on with it
    went_on = record.contact == "barrier" and contact == "auto"
    _check_same_contact(record, "barrier" if went_on else chosen_contact(contact), indenter_sha256)
    mesh = _same_mesh(record, design)
    if record.contact != "barrier":
        _check_same_points(record, rigid_indenter(design, folder), mesh)
    return _as_press(record, mesh)


def _check_same_design(record: PressIncrement, design: FingerDesign) -> None:
    """Check that a design differs at most in its push from that of an increment."""
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
            f"the stored increment belongs to another design, which differs in {', '.join(other) or 'mesh'}; only "
            "indenter.depth_mm may change when a press is continued"
        )


def _check_same_contact(record: PressIncrement, contact: ContactKind, indenter_sha256: str | None) -> None:
    """Check that contact and STL are those of an increment, as far as it tells them."""
    if record.contact is not None and record.contact != contact:
        raise SimulateError(
            f"the stored increment was pressed with --contact {record.contact}, but --contact {contact} was given; "
            f"give --contact {record.contact}, or press again from the beginning"
        )
    if record.indenter_sha256 is not None and record.indenter_sha256 != indenter_sha256:
        raise SimulateError(
            f"the STL of the indenter, indenter.file = {record.design.indenter.file!r}, has changed since the stored "
            "increment was computed; restore the original file, or press again from the beginning"
        )


def _same_mesh(record: PressIncrement, design: FingerDesign) -> FingerMesh:
    """Return the mesh of an increment, which must be that of the design."""
    mesh = finger_mesh(design, record.preset)
    own = len(mesh.nodes_mm)
    # a barrier's indenter is one node more
    if len(record.nodes_mm) not in {own, own + 1} or not np.array_equal(record.nodes_mm[:own], mesh.nodes_mm):
        raise SimulateError(
            "the stored increment has another mesh of this design, made by another version; press again from the "
            "beginning"
        )
    return replace(mesh, nodes_mm=record.nodes_mm)


def _check_same_points(record: PressIncrement, indenter: RigidIndenter, mesh: FingerMesh) -> None:
    """Check that the penalty acts at the points of an increment, as far as they touch.

    Older versions took 2 x 2 Gauss points of each face for every indenter, none of them on the border of the coat.
    """
    nodes, coat, body = mesh.nodes_mm, mesh.surfaces["coat"], indenter.exact_body()
    points = coat_points(nodes, coat, body)
    had, has = record.points_per_side or 2, math.isqrt(points.places.shape[1])
    at_border = np.flatnonzero((points.places != face_points(coat, has, to_border=False).places).any(axis=(1, 2)))
    if had != has:
        other = (
            f"at {had} x {had} points of each face of the coat; with this indenter, contact now acts at {has} x {has}"
        )
    elif not record.points_on_border and _touches(record, indenter, mesh, at_border):
        other = "at no point of the coat's border, which the indenter touches here and where contact now acts too"
    else:
        return
    raise SimulateError(
        f"the stored increment is of an older version, in which contact may have acted {other}, so its forces would "
        "not be consistent with those that follow. Press again from the beginning (leave out --resume, and give "
        "another --out)"
    )


def _touches(record: PressIncrement, indenter: RigidIndenter, mesh: FingerMesh, faces: NDArray[np.int64]) -> bool:
    """Return whether some of the coat's faces touch the indenter at an increment, at points of then or of now."""
    coat, pose = mesh.surfaces["coat"], indenter.pose(float(record.depth_mm[-1]))
    body = indenter.exact_body()
    return any(
        PenaltyContact(mesh.nodes_mm, points.of(faces), body, pose, 1.0).gaps_mm(record.displacement_mm).min() < 0.0
        for points in (face_points(coat, to_border=False), coat_points(mesh.nodes_mm, coat, body))
    )


def _as_press(record: PressIncrement, mesh: FingerMesh) -> PressedFinger:
    """Return an increment as a press."""
    with_modes = [block.element == "incompatible_modes" for block in mesh.blocks]
    sizes = [len(block.hexahedra) if has else 0 for block, has in zip(mesh.blocks, with_modes, strict=True)]
    parts = np.split(record.modes_mm, np.cumsum(sizes)[:-1])
    nothing = np.empty((0, 0))
    return PressedFinger(
        mesh=mesh,
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
        contact_energy_n_mm=record.contact_energy_n_mm,
        friction_work_n_mm=record.friction_work_n_mm,
        kind=record.contact or "unknown",
        unstable=record.unstable,
        parts_touch_from_mm=record.parts_touch_from_mm,
    )


def _mechanics(
    design: FingerDesign, preset: Preset, pressed: PressedFinger, engine: str, notes: tuple[str, ...]
) -> PressMechanics:
    """Return what the press took."""
    gel = design.mechanics.gel
    slip, tipping = _torques(design, pressed)
    return PressMechanics(
        name=f"{design.name}, {_what_was_done(pressed)}",
        label=f"{engine}, {preset} mesh, {pressed.displacement_mm[0].size} unknowns",
        preset=preset,
        mesh_excess_rel=FORCE_EXCESS_REL[preset],
        depth_mm=pressed.depth_mm,
        force_n=pressed.force_n,
        energy_n_mm=pressed.energy_n_mm,
        contact_energy_n_mm=pressed.contact_energy_n_mm,
        friction_work_n_mm=pressed.friction_work_n_mm,
        iterations=pressed.iterations,
        largest_pressure_mpa=float(pressed.pressure_mpa.max()),
        unreached=pressed.unreached,
        slip_torque_per_friction_n_mm=slip,
        tipping_torque_n_mm=tipping,
        design=design,
        motion=None if pressed.motion is None else _motion(design, pressed, pressed.motion),
        notes=(
            pressed.contact,
            *([f"{pressed.crossing}: the results from there on are not physical"] if pressed.crossing else []),
            *([pressed.unstable] if pressed.unstable else []),
            *_chord_note(design, preset, pressed),
            f"gel: {_law(gel)}, K/mu = {gel.bulk_over_shear:g} (the paper gives no K)",
            *([f"skeleton: {_law(design.mechanics.skeleton)}"] if design.mechanics.skeleton.law is not None else []),
            f"mesh: on the 70 x 35 finger, a mesh this fine gives {100 * FORCE_EXCESS_REL[preset]:.0f} % more force "
            "than an infinitely fine mesh (extrapolated)",
            "dimensions of the skeleton are assumed unless the design's origin says otherwise; forces are unvalidated",
            *notes,
        ),
    )


def _law(solid: Rubber) -> str:
    """Return a rubber's law in words; of another package, with its constants."""
    if solid.law is None:
        return f"C10 = {getattr(solid, 'c10_mpa'):g} MPa"  # noqa: B009
    constants = ", ".join(f"{name} = {value:g}" for name, value in solid.parameters.items())
    return f"law {solid.law} of {solid.package} ({constants or 'no parameters'}), whose uncertainty is not known"


def _what_was_done(pressed: PressedFinger) -> str:
    """Return in words how far the indenter went."""
    if pressed.motion is None:
        return f"push of {pressed.depth_mm[-1]:g} mm"
    return f"path of {len(pressed.depth_mm)} increments to a push of {pressed.depth_mm[-1]:g} mm"


def _motion(design: FingerDesign, pressed: PressedFinger, motion: ContactMotion) -> PressMotion:
    """Return the path and its contact, of the points that touch at one increment at least."""
    touched = motion.pressure_mpa.max(axis=0) > 0.0
    areas = touch_areas_mm2(pressed)[touched]  # to the distortion of a face
    pressure, slip = motion.pressure_mpa[:, touched], motion.slip_mm[:, touched]
    touches = pressure > 0.0
    return PressMotion(
        moves_mm=motion.moves_mm,
        turns_deg=motion.turns_deg,
        origins_mm=motion.origins_mm,
        torque_n_mm=motion.torque_n_mm,
        patch_mm2=touches @ areas,
        stuck_mm2=(touches & (slip == 0.0)) @ areas,
        friction=design.indenter.friction,
        points_mm=pressed.touch_mm[touched],
        point_areas_mm2=areas,
        pressure_mpa=pressure,
        shear_mpa=motion.shear_mpa[:, touched],
        slip_mm=slip,
    )


def _chord_note(design: FingerDesign, preset: Preset, pressed: PressedFinger) -> tuple[str, ...]:
    """Say how much too low the penalty's force is on a round indenter."""
    short = chord_shortfall_rel(design, preset, float(pressed.depth_mm[-1]))
    touched = pressed.force_n[-1, 1] > 0.0
    if pressed.motion is not None and not touched:
        return ()
    if pressed.kind != "penalty" or (touched and not short):
        return ()
    told = f"the force is some {100 * short:.0f} % below that with barrier contact"
    if not touched:
        told = (
            "the indenter touches no node, or has passed between the nodes, so that the force comes from the mesh, "
            "not from the finger"
        )
    return (f"between nodes the coat passes into the indenter: {told}",)


def _torques(design: FingerDesign, pressed: PressedFinger) -> tuple[float | None, float | None]:
    """Return the torques that the contact holds: by friction over its coefficient, and by its width.

    None without contact, with a force that pulls (the indenter has passed through the coat), and of a press with
    friction: they rest on frictionless pressures.
    """
    touches = (pressed.pressure_mpa > 0.0).any() and pressed.force_n[-1, 1] > 0.0
    if design.indenter.friction > 0.0 or not touches:
        return None, None
    places, forces = contact_forces_n(pressed)
    return slip_torque_n_mm(places, forces, 1.0), tipping_torque_n_mm(design, places, forces)


def tipping_torque_n_mm(design: FingerDesign, places_mm: NDArray[np.float64], forces_n: NDArray[np.float64]) -> float:
    """Return the torque about the finger's long axis that a frictionless contact holds, by the shape of the indenter.

    All normal forces on a ball pass through its centre, so it turns freely. A cuboid tips over the flat part of its
    face, which may be narrower than the pad; any other body is taken to reach over the whole pad, as a cylinder does.
    """
    indenter, half_mm = design.indenter, design.pad.width_mm / 2.0
    if indenter.shape == "ball":
        return 0.0
    low_mm, high_mm = -half_mm, half_mm
    if indenter.size_mm is not None:
        flat_mm = indenter.size_mm[0] / 2.0 - indenter.edge_radius_mm
        low_mm, high_mm = max(low_mm, indenter.across_mm - flat_mm), min(high_mm, indenter.across_mm + flat_mm)
    middle_mm = np.array([(low_mm + high_mm) / 2.0, 0.0, 0.0])
    return max(frictionless_torque_n_mm(places_mm - middle_mm, forces_n, high_mm - low_mm), 0.0)


def _surfaces(design: FingerDesign, pressed: PressedFinger, engine: str) -> FingerSurfaces:
    """Return the finger without and with contact."""
    mesh = pressed.mesh
    nodes = coat_nodes(design, mesh.nodes_mm, mesh.hexahedra)
    label = f"{engine}, {_what_was_done(pressed)}"
    rest = shape_from_mesh(design, mesh.nodes_mm, mesh.hexahedra)
    deformed = shape_from_mesh(
        design,
        mesh.nodes_mm,
        mesh.hexahedra,
        pressed.displacement_mm[-1],
        contact_distance(pressed, nodes),
        label,
    )
    return store_shapes(rest, deformed, f"{design.name}, pressed", float(pressed.depth_mm[-1]))
