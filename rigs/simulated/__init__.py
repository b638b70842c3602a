"""A simulated rig: paints, bench, sensor and devices, computed without the forward model of the fit.

The bench turns a painted sample under a light and behind a filter into photo-electrons per second, the sensor turns
photo-electrons into counts (the only such model; the tactile renderer uses it too), the devices move and light the
bench and have faults. A bench that shared the fitter's band integration would hide its errors.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.simulated._bench import Bench, BenchTruth, bench_scene, bench_truth
    from rigs.simulated._devices import (
        BenchFault,
        BenchState,
        RigCondition,
        SimulatedCamera,
        SimulatedClock,
        SimulatedFilterWheel,
        SimulatedLight,
        SimulatedOperator,
        SimulatedPhotodiode,
        with_fault,
    )
    from rigs.simulated._finger import FingerCamera, FingerOperator, FingerState, SimulatedLoadCell, SimulatedStage
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "Bench",
    "BenchFault",
    "BenchState",
    "BenchTruth",
    "FingerCamera",
    "FingerOperator",
    "FingerState",
    "RigCondition",
    "SimulatedCamera",
    "SimulatedClock",
    "SimulatedFilterWheel",
    "SimulatedLight",
    "SimulatedLoadCell",
    "SimulatedOperator",
    "SimulatedPhotodiode",
    "SimulatedStage",
    "bench_scene",
    "bench_truth",
    "with_fault",
]
