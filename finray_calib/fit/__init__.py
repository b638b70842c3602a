r"""Fit a paint: from band signals to the posterior of its emission, reflectance and absorption.

.. math:: p(\theta | y) \propto p(\theta)\, N\bigl(y;\; \mu(\theta),\; S + U U^T + L L^T + D(\theta)\bigr), \quad
    L_i = g_i \mu_i(\theta)

with the measurement covariance S, the imperfections U of the rig, its lamp's share of error g in each band, and
the discrepancy D of the paint from its family of curves. `calibrate_paint` runs the whole path and returns the stored
record, `map_paint` fits every pixel, `detect_emission` decides whether there is anything to fit. `combine_sessions`
makes one of several sessions of a paint, with what differs between them. Draws come from importance sampling that
diagnoses itself; where it is not good enough, Markov steps move the draws further, and emcee is the independent check.
`uncertainty_budget` states how much each source contributes to an interval, `design_filters` which filters would make
it smaller. No devices, and no files but the prototypes of spectra that the package ships.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.fit._absorption import ExcitationYield, fit_absorption
    from finray_calib.fit._band_data import BandData, band_data
    from finray_calib.fit._colour_checker import (
        colour_checker_reflectance,
        find_colour_checker,
        linear_cells,
        patch_colours,
    )
    from finray_calib.fit._detection import allowed_stray_per_nm, detect_emission
    from finray_calib.fit._emission import (
        EmissionPosterior,
        FitSettings,
        Summary,
        check_bands,
        estimate,
        fit_emission,
        summarise,
    )
    from finray_calib.fit._family_choice import (
        DEFAULT_FAMILY,
        FitOptions,
        choose_family,
        fit_families,
        leave_one_band_out,
        score_families,
    )
    from finray_calib.fit._filter_design import (
        CatalogueFilter,
        FilterDesign,
        NextFilter,
        design_filters,
        filter_catalogue,
        next_filters,
        stock_catalogue,
    )
    from finray_calib.fit._importance import (
        FEWEST_EFFECTIVE,
        LARGEST_PARETO_K,
        MixtureProposal,
        importance_sample,
        smooth_weights,
    )
    from finray_calib.fit._likelihood import LogPosterior, Maxima, find_maxima
    from finray_calib.fit._markov_chains import (
        LARGEST_MEMORY,
        LARGEST_R_HAT,
        SMALLEST_EFFECTIVE_SAMPLES,
        ChainDiagnostics,
        SamplerSettings,
        autocorrelation_time,
        bulk_ess,
        rank_r_hat,
        sample_posterior,
    )
    from finray_calib.fit._paint_calibration import (
        LARGEST_CHAIN_SHIFT_SD,
        PAPER_FAMILY,
        calibrate_paint,
        curve_bands,
        paper_parameters,
        reflectance,
    )
    from finray_calib.fit._pixel_maps import PixelSpread, map_paint, map_pixels
    from finray_calib.fit._prior import (
        NO_DISCREPANCY,
        PAINT_DISCREPANCY,
        AbsorptionPrior,
        Discrepancy,
        EmissionPrior,
        Prior,
    )
    from finray_calib.fit._repeated_sessions import combine_sessions, outlying_session_warnings
    from finray_calib.fit._reported_spectrum import MEASURED_SPECTRA_TITLE, TwoMaxima, two_maxima
    from finray_calib.fit._sensor_posterior import (
        PictureBlocks,
        PicturePosterior,
        picture_blocks,
        placed_picture,
        sample_picture_posterior,
    )
    from finray_calib.fit._uncertainty_budget import BUDGETED, BudgetRow, uncertainty_budget
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "BUDGETED",
    "DEFAULT_FAMILY",
    "FEWEST_EFFECTIVE",
    "LARGEST_CHAIN_SHIFT_SD",
    "LARGEST_MEMORY",
    "LARGEST_PARETO_K",
    "LARGEST_R_HAT",
    "MEASURED_SPECTRA_TITLE",
    "NO_DISCREPANCY",
    "PAINT_DISCREPANCY",
    "PAPER_FAMILY",
    "SMALLEST_EFFECTIVE_SAMPLES",
    "AbsorptionPrior",
    "BandData",
    "BudgetRow",
    "CatalogueFilter",
    "ChainDiagnostics",
    "Discrepancy",
    "EmissionPosterior",
    "EmissionPrior",
    "ExcitationYield",
    "FilterDesign",
    "FitOptions",
    "FitSettings",
    "LogPosterior",
    "Maxima",
    "MixtureProposal",
    "NextFilter",
    "PictureBlocks",
    "PicturePosterior",
    "PixelSpread",
    "Prior",
    "SamplerSettings",
    "Summary",
    "TwoMaxima",
    "allowed_stray_per_nm",
    "autocorrelation_time",
    "band_data",
    "bulk_ess",
    "calibrate_paint",
    "check_bands",
    "choose_family",
    "colour_checker_reflectance",
    "combine_sessions",
    "curve_bands",
    "design_filters",
    "detect_emission",
    "estimate",
    "filter_catalogue",
    "find_colour_checker",
    "find_maxima",
    "fit_absorption",
    "fit_emission",
    "fit_families",
    "importance_sample",
    "leave_one_band_out",
    "linear_cells",
    "map_paint",
    "map_pixels",
    "next_filters",
    "outlying_session_warnings",
    "paper_parameters",
    "patch_colours",
    "picture_blocks",
    "placed_picture",
    "rank_r_hat",
    "reflectance",
    "sample_picture_posterior",
    "sample_posterior",
    "score_families",
    "smooth_weights",
    "stock_catalogue",
    "summarise",
    "two_maxima",
    "uncertainty_budget",
]
