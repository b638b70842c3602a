r"""Spectral curves and how a rig measures them: emission families, band weights, the re-radiation matrix.

A paint that reflects rho of the laser and emits f per nm has in band b of channel c the value

.. math:: y_{bc} = \int w_{bc}(\lambda)\,f(\lambda)\,d\lambda + \rho\,l_{bc}

with weights w and l from the curves of filters, camera, lamp, white reference and laser. Here are these weights, their
quadrature of few nodes and their tolerances, the four families of f, and the re-radiation (Donaldson) matrix that
emission and absorption make together. Functions are compiled by `compiled`; no other module imports Numba. No files, no
devices.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.spectra._band_weights import (
        BAND_NODES,
        GRID_STEP_NM,
        LN_10,
        WAVELENGTH_NM,
        BandQuadrature,
        BandTolerances,
        EmissionWeights,
        FilterSet,
        band_quadrature,
        band_tolerances,
        emission_weights,
        extrapolated_shares,
        filter_transmission,
        gauss_nodes,
        lamp_response,
        rig_emission_weights,
        transmissions,
        trapezoidal_weights,
    )
    from finray_calib.spectra._emission_families import (
        COMMON_PARAMETERS,
        FAMILIES,
        YIELD_END_NM,
        CurveQuantities,
        EmissionFamily,
        SkewCauchy,
        curve_quantities,
        family_named,
        from_mode_parameters,
        skew_cauchy,
        skew_shape_table,
    )
    from finray_calib.spectra._reradiation_matrix import (
        ReradiationMatrix,
        absorptance,
        photon_yield,
        reradiation_matrix,
        smooth_covariance,
    )
    from finray_calib.spectra.family_kernels import compiled, compiled_in_parallel, compiled_inside, machine_threads
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "BAND_NODES",
    "COMMON_PARAMETERS",
    "FAMILIES",
    "GRID_STEP_NM",
    "LN_10",
    "WAVELENGTH_NM",
    "YIELD_END_NM",
    "BandQuadrature",
    "BandTolerances",
    "CurveQuantities",
    "EmissionFamily",
    "EmissionWeights",
    "FilterSet",
    "ReradiationMatrix",
    "SkewCauchy",
    "absorptance",
    "band_quadrature",
    "band_tolerances",
    "compiled",
    "compiled_in_parallel",
    "compiled_inside",
    "curve_quantities",
    "emission_weights",
    "extrapolated_shares",
    "family_named",
    "filter_transmission",
    "from_mode_parameters",
    "gauss_nodes",
    "lamp_response",
    "machine_threads",
    "photon_yield",
    "reradiation_matrix",
    "rig_emission_weights",
    "skew_cauchy",
    "skew_shape_table",
    "smooth_covariance",
    "transmissions",
    "trapezoidal_weights",
]
