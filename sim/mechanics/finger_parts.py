"""Materials and ties of a design, as the engine takes them."""

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.mechanical_design import ElasticSolid, NeoHookeSolid, OgdenSolid
from sim.mechanics.materials import LinearElastic, Ogden, check_stability, neo_hooke
from sim.mechanics.mesh import FingerMesh
from sim.mechanics.ties import TiedNodes

# per node, against the fin's E times element size: the tie opens by a hundredth of the fin's own strain
_TIE_MODULI_TIMES_STEP = 100.0


def finger_materials(design: FingerDesign) -> dict[str, Ogden | LinearElastic]:
    """Return the engine's materials by the names that the mesh's blocks give.

    Raises
    ------
    SimulateError
        When a rubber's constants make it unstable.
    """
    found: dict[str, Ogden | LinearElastic] = {}
    for name in type(design.mechanics).model_fields:
        solid = getattr(design.mechanics, name)
        if isinstance(solid, OgdenSolid):
            rubber = Ogden(solid.mu_mpa, solid.alpha, solid.bulk_over_shear)
            try:
                check_stability(rubber)
            except SimulateError as unstable:
                raise SimulateError(f"mechanics.{name}: {unstable}") from unstable
            found[name] = rubber
        elif isinstance(solid, NeoHookeSolid):
            found[name] = neo_hooke(solid.c10_mpa, solid.bulk_over_shear)
        elif isinstance(solid, ElasticSolid):
            found[name] = LinearElastic(solid.youngs_modulus_mpa, solid.poisson_ratio)
    return found


def finger_ties(design: FingerDesign, mesh: FingerMesh, step_mm: float) -> list[TiedNodes]:
    """Return the ties of the mesh."""
    fin = finger_materials(design)["skeleton"]
    stiffness = _TIE_MODULI_TIMES_STEP * fin.youngs_modulus_mpa * step_mm
    return [TiedNodes(mesh.nodes_mm, tie, stiffness) for tie in mesh.ties]
