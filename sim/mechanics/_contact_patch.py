"""What the contact of a pressed finger is: its pressures, patch and forces, and the torque that it can hold."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from data_schemas import SimulateError
from sim.mechanics._mesh import FingerMesh

if TYPE_CHECKING:
    from sim.mechanics._press import PressedFinger

FloatArray = NDArray[np.float64]

# a patch that reaches over this share of the pad is a strip across it
_WHOLE_WIDTH = 0.95


def coat_areas_mm2(mesh: FingerMesh) -> FloatArray:
    """Return the areas at rest of the coat's f faces, (f,)."""
    corners = mesh.nodes_mm[mesh.surfaces["coat"]]
    return np.asarray(
        np.linalg.norm(np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1) / 2.0
    )


def contact_pressure_mpa(pressed: "PressedFinger") -> FloatArray:
    """Return the contact pressure of the last increment at the mesh's n nodes, (n,); 0 away from the coat.

    p_a = sum_f A_f p_f / sum_f A_f over the faces f at node a, with p_f the mean of a face's points and A_f its area
    at rest: pressure times the coat's area is the same at the nodes as on the faces.
    """
    faces, areas = pressed.mesh.surfaces["coat"], coat_areas_mm2(pressed.mesh)
    count = len(pressed.mesh.nodes_mm)
    held = np.bincount(faces.ravel(), np.repeat(areas * pressed.pressure_mpa.mean(axis=1), 4), count)
    area = np.bincount(faces.ravel(), np.repeat(areas, 4), count)
    return np.asarray(np.divide(held, area, out=np.zeros(count), where=area > 0.0))


def contact_distance(pressed: "PressedFinger", nodes: NDArray[np.int64]) -> FloatArray:
    """Return the distance of coat nodes from the middle of the contact in units of its half-width; <= 1 in contact.

    The patch is taken as an ellipse in the undeformed pad, or as a strip where it reaches across the pad. It ends half
    the distance between sampling points beyond the outermost one that touches, and is known to about that. NaN without
    contact.
    """
    touching = pressed.touch_mm[pressed.pressure_mpa > 0.0]
    # two Gauss points lie 1/sqrt(3) of a face apart, on average half a face
    margin = np.median(np.ptp(pressed.touch_mm, axis=1), axis=0) * np.sqrt(3.0) / 4.0
    if not len(touching):
        return np.full(len(nodes), np.nan)
    places = pressed.mesh.nodes_mm[nodes]
    squares = np.zeros(len(nodes))
    for axis in (0, 2):
        low, high = touching[:, axis].min() - margin[axis], touching[:, axis].max() + margin[axis]
        pad_low, pad_high = places[:, axis].min(), places[:, axis].max()
        if high - low < _WHOLE_WIDTH * (pad_high - pad_low):
            squares += ((places[:, axis] - (low + high) / 2.0) / ((high - low) / 2.0)) ** 2
    return np.asarray(np.sqrt(squares))


def contact_forces_n(pressed: "PressedFinger") -> tuple[FloatArray, FloatArray]:
    """Return where a pressed contact pushes, places on the coat at rest (k, 3), and how hard, (k,) in N.

    The pressures times their areas, made to add up to the size of the force on the indenter; places at rest: the
    patch's own stretch, a few per cent, is left out.
    """
    pushes = pressed.pressure_mpa * coat_areas_mm2(pressed.mesh)[:, None]
    touching = pushes > 0.0
    whole = float(pushes.sum())
    if whole <= 0.0:
        raise SimulateError("nothing touches, and without pressure there is no torque to compute; press deeper")
    return pressed.touch_mm[touching], pushes[touching] * float(np.linalg.norm(pressed.force_n[-1])) / whole


def slip_torque_n_mm(places_mm: FloatArray, forces_n: FloatArray, friction: float) -> float:
    r"""Return the torque about the pad's normal at which a pressed object begins to turn on the pad.

    T = mu min_c sum_i N_i |r_i - c|, in the plane across the normal (x, z).

    Coulomb's law with the frictionless normal forces N_i, taken to stay as they are while the object slides, on all
    of the patch at once, as a rigid body about the centre c that holds least (limit analysis: with c the friction
    forces add up to nothing, a pure torque). The pad's own shear before that, and the change of the pressures by
    friction, are left out.

    Parameters
    ----------
    places_mm, forces_n
        Of the normal forces, (k, 3) and (k,): see :func:`contact_forces_n`.
    friction
        Coulomb's coefficient mu between object and coat.

    Raises
    ------
    SimulateError
        When the coefficient is negative.
    """
    if not 0.0 <= friction < np.inf:
        raise SimulateError(f"friction = {friction:g}: Coulomb's coefficient must be finite and not negative")
    flat = places_mm[:, [0, 2]]

    def torque(centre: FloatArray) -> float:
        return float(forces_n @ np.linalg.norm(flat - centre, axis=1))

    start = forces_n @ flat / forces_n.sum()
    return friction * float(minimize(torque, start, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9}).fun)


def frictionless_torque_n_mm(places_mm: FloatArray, forces_n: FloatArray, width_mm: float) -> float:
    """Return the torque about the finger's long axis that normal forces alone can hold: T = N (w / 2 - |x|).

    x is where their resultant N acts across the finger. An object that turns about that axis shifts the resultant
    towards the pad's edge and tips over it there; the finger's own twist (see
    :meth:`sim.mechanics.LoadedFinger.twist`) is left out.

    Parameters
    ----------
    places_mm, forces_n
        Of the normal forces, (k, 3) and (k,).
    width_mm
        Of the pad.
    """
    whole = float(forces_n.sum())
    return whole * (width_mm / 2.0 - abs(float(forces_n @ places_mm[:, 0]) / whole))
