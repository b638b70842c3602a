"""The torque that a pressed contact can hold before the object turns on the pad."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from data_schemas.errors import SimulateError
from sim.mechanics.pressed_finger import PressedFinger, coat_areas_mm2

FloatArray = NDArray[np.float64]


def contact_forces_n(pressed: PressedFinger) -> tuple[FloatArray, FloatArray]:
    """Return where a pressed contact pushes, places on the coat at rest (k, 3), and how hard, (k,) in N.

    The pressures times their areas, made to add up to the size of the force on the indenter; places at rest: the
    patch's own stretch, a few per cent, is left out.
    """
    pushes = pressed.pressure_mpa * coat_areas_mm2(pressed.mesh)[:, None]
    touching = pushes > 0.0
    whole = float(pushes.sum())
    if whole <= 0.0:
        raise SimulateError("nothing touches: a contact without pressure holds no torque; press deeper")
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
    :meth:`sim.mechanics.loads.LoadedFinger.twist`) is left out.

    Parameters
    ----------
    places_mm, forces_n
        Of the normal forces, (k, 3) and (k,).
    width_mm
        Of the pad.
    """
    whole = float(forces_n.sum())
    return whole * (width_mm / 2.0 - abs(float(forces_n @ places_mm[:, 0]) / whole))
