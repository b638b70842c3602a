"""A small made-up run of all six stages, from a seed: the numbers look like those of a real run, and are not."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    AngleConstraints,
    AngleObjective,
    AngleProposal,
    AngleStatement,
    BandPassFilter,
    BandResidual,
    BandSignals,
    CaptureSession,
    ChainCheck,
    DecidingCapture,
    Diagnostics,
    DiscrepancySettings,
    ErrorRow,
    Estimate,
    FamilyResult,
    FilterWheelSettings,
    FingerDesign,
    Frame,
    HiddenPaint,
    IndenterPose,
    InputUncertainty,
    Interval,
    LaserSettings,
    LightAngleDecision,
    LightAngleSweep,
    MonteCarlo,
    ObjectiveError,
    Optics,
    OtherObjective,
    PaintCalibration,
    PaintPlan,
    PhotometricErrorReport,
    PriorSensitivity,
    Provenance,
    RegionError,
    RegionOfInterest,
    Reradiation,
    RigFile,
    SimulatedBench,
    SimulatedPress,
    SpectralCurve,
    TactileCapture,
    ValidationCell,
    WhiteReference,
)
from finray_calib.demo import DemoResults, PaintResult
from finray_calib.demo._results import Colour
from finray_calib.reports import PaintTruth

Floats = NDArray[np.float64]
SEED = 20261121
WAVELENGTH_NM = np.arange(400.0, 781.0, 2.0)
CENTERS_NM = (405.0, 450.0, 500.0, 532.0, 560.0, 600.0, 630.0, 660.0)
EXCITATION_NM = np.arange(300.0, 701.0, 5.0)
LASER_NM = 450.0
SAMPLED = (
    "shape_mode_nm",
    "ln_shape_fwhm_nm",
    "ln_shape_peak_per_nm",
    "ln_asymmetry",
    "ln_reflected_laser",
    "ln_blocking",
)
PRIOR_MEAN = np.array([560.0, np.log(50.0), np.log(3e-3), 0.35, np.log(0.1), 0.0])
PRIOR_SD = np.array([60.0, 0.3, 1.2, 0.2, 1.5, 1.0])
POSTERIOR_SD = np.array([0.8, 0.02, 0.02, 0.1, 0.01, 0.6])
CURVE_DRAWS = 40
NOISE_REL = 0.012
HEIGHT_PX, WIDTH_PX = 96, 128


def example_results(seed: int = SEED, paint_name: str = "fluorescent red", measured_green: bool = True) -> DemoResults:
    """Return a whole run; the green paint has a tail that the fitted curve misses."""
    rng = np.random.default_rng(seed)
    optics = _optics()
    red = _paint("red", paint_name, (606.0, 48.0, 4.5e-3), 0.0, optics, rng)
    green = _paint("green", "fluorescent green", (519.0, 36.0, 6.2e-3), 0.22 if measured_green else 0.0, optics, rng)
    if not measured_green:
        green = replace(green, truth=replace(green.truth, kind="simulated paint of the paper's family"))
    press, capture, report = _comparison(rng)
    sweep, true_sweep = _sweep(rng, 32.0, 3), _sweep(rng, 34.0, 1)
    return DemoResults(
        paints={"red": red, "green": green},
        press=press,
        capture=capture,
        report=report,
        sweep=sweep,
        decision=example_decision("tie"),
        stage_wall_times_s={
            "capture": 8.2,
            "radiometry": 3.1,
            "fit": 11.4,
            "simulate": 44.0,
            "compare": 1.6,
            "decide": 0.9,
        },
        renderer_note="Rendered with the path tracer, level b (paint as a textured emitter), 64 samples per pixel.",
        command="finray demo --out demo-run --seed 1",
        provenance=Provenance(
            created_utc="2026-11-21T20:00:00+00:00",
            command="finray demo --out demo-run --seed 1",
            package_version="0.1.0",
            git_commit="0123456789abcdef0123456789abcdef01234567",
            python_version="3.11.2",
            input_sha256={"demo.toml": "ab" * 32},
            seed=seed,
        ),
        true_sweeps=(true_sweep,),
        report_level_a=_scored(report, 0.702),
    )


def _bell(x: Floats, center: float, fwhm: float) -> Floats:
    """Return a bell curve of height 1."""
    return np.asarray(np.exp(-4 * np.log(2) * ((x - center) / fwhm) ** 2))


def _emission(x: Floats, mode_nm: float, fwhm_nm: float, peak_per_nm: float) -> Floats:
    """Return a curve with a Lorentzian tail on the long side and a bell on the short side."""
    tail = 1 / (1 + (2 * (x - mode_nm) / (1.15 * fwhm_nm)) ** 2)
    return np.asarray(peak_per_nm * np.where(x > mode_nm, tail, _bell(x, mode_nm, 0.85 * fwhm_nm)))


def _curve(name: str, values: Floats, source: str = "assumed") -> SpectralCurve:
    """Return a curve on the common grid."""
    return SpectralCurve(name=name, wavelength_nm=WAVELENGTH_NM, values=values, source=source)


def _optics() -> Optics:
    """Return the known curves of the example rig."""
    red, green, blue = (
        _curve(n, _bell(WAVELENGTH_NM, c, 100.0)) for n, c in (("R", 610.0), ("G", 535.0), ("B", 455.0))
    )
    return Optics(
        filters=_filters(),
        excitation_filter="450",
        laser=LaserSettings(),
        lamp=_curve("lamp", WAVELENGTH_NM / 560.0, "Planck at 2856 K"),
        white_reference=WhiteReference(),
        camera_response=(red, green, blue),
    )


def _filters() -> tuple[BandPassFilter, ...]:
    """Return the eight filters of the wheel."""
    return tuple(BandPassFilter(slot=i + 1, name=f"{c:g}", center_nm=c) for i, c in enumerate(CENTERS_NM))


def _estimate(median: float, sd: float) -> Estimate:
    """Return a normal posterior summary."""
    return Estimate(
        estimate=median,
        sd=sd,
        low68=median - sd,
        high68=median + sd,
        low95=median - 1.96 * sd,
        high95=median + 1.96 * sd,
    )


def _paint(
    colour: Colour,
    name: str,
    shape: tuple[float, float, float],
    second_peak_rel: float,
    optics: Optics,
    rng: np.random.Generator,
) -> PaintResult:
    """Return one paint; `second_peak_rel` adds a peak to the truth that the fitted curve does not have."""
    mode_nm, fwhm_nm, peak_per_nm = shape
    truth_values = _emission(WAVELENGTH_NM, *shape)
    truth_values = truth_values + second_peak_rel * peak_per_nm * _bell(WAVELENGTH_NM, mode_nm + 70.0, 50.0)
    bands, predicted = _bands(name, truth_values, shape, optics, rng)
    kind = "simulated paint of the paper's family" if second_peak_rel == 0 else "measured material green.csv"
    truth = PaintTruth(_curve("truth", truth_values), mode_nm, fwhm_nm, float(truth_values.sum() * 2.0), kind)
    return PaintResult(
        colour=colour,
        session=_session(name),
        bands=bands,
        calibration=_calibration(name, shape, optics, bands, predicted, rng),
        truth=truth,
        room_light_rgb8=_preview(colour, rng),
    )


def _bands(
    name: str, truth: Floats, shape: tuple[float, float, float], optics: Optics, rng: np.random.Generator
) -> tuple[BandSignals, Floats]:
    """Return band signals of the truth, and what the fitted curve predicts."""
    at_filters = [np.interp(CENTERS_NM, WAVELENGTH_NM, curve) for curve in (truth, _emission(WAVELENGTH_NM, *shape))]
    shares = np.array([[1.0, 0.97, 1.03]])
    true, predicted = (90.0 * values[:, None] * shares + 1e-5 for values in at_filters)
    true[1] = predicted[1] = 0.06 * shares
    signal = true * (1 + 0.008 * rng.standard_normal(true.shape))
    weak = signal < 3e-4
    bands = BandSignals(
        paint_name=name,
        optics=optics,
        fluorescence=signal,
        fluorescence_covariance=np.diag((NOISE_REL * signal + 1e-5).ravel() ** 2),
        reflectance=0.2 + 0.5 * signal / signal.max() + 0.01 * rng.standard_normal(signal.shape),
        reflectance_covariance=np.eye(24) * 1e-4,
        channel_weights=np.array([0.3, 0.4, 0.3]),
        flags=tuple(tuple("weak" if w else "ok" for w in row) for row in weak),
        saturated_fraction=np.zeros((8, 3)),
        region_pixels=51_200,
        notes=(
            "camera response R covers only 400 to 780 nm; outside, where 0.4 % of the weight of 405 nm lies, its "
            "end value is used",
        ),
    )
    return bands, predicted


def _calibration(
    name: str,
    shape: tuple[float, float, float],
    optics: Optics,
    bands: BandSignals,
    predicted: Floats,
    rng: np.random.Generator,
) -> PaintCalibration:
    """Return the posterior of a paint."""
    mode_nm, fwhm_nm, peak_per_nm = shape
    center = np.array([mode_nm - 0.4, np.log(fwhm_nm * 1.01), np.log(peak_per_nm), 0.3, np.log(0.06), 0.1])
    fit = _emission(WAVELENGTH_NM, mode_nm - 0.4, fwhm_nm * 1.01, peak_per_nm * 0.995)
    paper = _emission(WAVELENGTH_NM, mode_nm - 3.0, fwhm_nm * 0.9, peak_per_nm * 1.1)
    spread = 0.015 * fit + 1e-2 * peak_per_nm * _bell(WAVELENGTH_NM, mode_nm, 2 * fwhm_nm)
    measured_sd = np.sqrt(np.diag(bands.fluorescence_covariance)).reshape(8, 3)
    chi = (((bands.fluorescence - predicted) / measured_sd) ** 2 * bands.usable()).sum(axis=1)
    quantities = _quantities(shape, float(fit.sum() * 2.0))
    emission_draws = np.maximum(fit + spread * rng.standard_normal((CURVE_DRAWS, 1)), 0.0)
    return PaintCalibration(
        paint_name=name,
        family="log_normal_wavenumber",
        family_title="log-normal in wavenumber",
        family_choice="log_normal_wavenumber: the default, and the most probable given these bands (zheng2014 0.12, "
        "log_normal_wavenumber 0.88)",
        discrepancy=DiscrepancySettings(
            amplitude_rel=0.12, length_nm=12.0, floor_rel=0.1, reabsorption_rel=0.1, origin="four measured materials"
        ),
        parameters={**quantities, "reflectance_at_laser": _estimate(0.06, 0.001)},
        paper={
            "location_nm": _estimate(mode_nm - 12.0, 1.5),
            "scale_nm": _estimate(0.7 * fwhm_nm, 1.0),
            "skewness": _estimate(1.34, 0.2),
            "amplitude_nm": _estimate(5.2, 0.3),
        },
        prior={p: f"normal({m:.3g}, {s:g})" for p, m, s in zip(SAMPLED, PRIOR_MEAN, PRIOR_SD, strict=True)},
        prior_sensitivity={key: PriorSensitivity(halved=-0.12, doubled=0.21) for key in quantities},
        sampled=SAMPLED,
        map_estimate=dict(zip(SAMPLED, center.tolist(), strict=True)),
        draws=center + POSTERIOR_SD * rng.standard_normal((400, 6)),
        prior_draws=PRIOR_MEAN + PRIOR_SD * rng.standard_normal((400, 6)),
        wavelength_nm=WAVELENGTH_NM,
        emission_per_nm=fit,
        emission_low95_per_nm=np.maximum(fit - 2 * spread, 0.0),
        emission_high95_per_nm=fit + 2 * spread,
        emission_low68_per_nm=np.maximum(fit - spread, 0.0),
        emission_high68_per_nm=fit + spread,
        emission_draws_per_nm=emission_draws,
        energy_yield=quantities["energy_yield"],
        band_integrals=tuple(_estimate(float(np.interp(c, WAVELENGTH_NM, fit)), 2e-5) for c in CENTERS_NM),
        families=_families(quantities),
        family_emission_per_nm=np.array([1.01 * fit, fit, paper]),
        family_low95_per_nm=np.array([fit - 2 * spread, fit - 2 * spread, paper - spread]),
        family_high95_per_nm=np.array([fit + 2 * spread, fit + 2 * spread, paper + spread]),
        reflectance=tuple(_estimate(0.2 + 0.06 * i, 0.012) for i in range(8)),
        reflectance_method="radiance factor less the fitted fluorescence",
        reradiation=_reradiation(mode_nm, rng),
        optics=optics,
        usable=bands.usable(),
        measured=bands.fluorescence,
        measured_sd=measured_sd,
        predicted=predicted,
        predicted_sd=NOISE_REL * predicted,
        bands=tuple(_residual(f, float(chi[i]), int(bands.usable()[i].sum())) for i, f in enumerate(optics.filters)),
        chi_square=float(chi.sum()),
        usable_values=int(bands.usable().sum()),
        diagnostics=_diagnostics(),
        warnings=("3.1 % of the fitted emission lies below the laser line, where none can be",),
    )


def _quantities(shape: tuple[float, float, float], energy_yield: float) -> dict[str, Estimate]:
    """Return what every family reports."""
    mode_nm, fwhm_nm, peak_per_nm = shape
    return {
        "mode_nm": _estimate(mode_nm - 0.4, 0.8),
        "fwhm_nm": _estimate(1.01 * fwhm_nm, 0.9),
        "skew": _estimate(0.24, 0.05),
        "peak_per_nm": _estimate(peak_per_nm, 2e-5),
        "energy_yield": _estimate(energy_yield, 0.004),
    }


def _families(quantities: dict[str, Estimate]) -> tuple[FamilyResult, ...]:
    """Return the paper's family, the reported one, and the paper's without discrepancy."""

    def family(
        name: str, title: str, with_discrepancy: bool, probability: float | None, left_out: float | None, sd: float
    ):
        return FamilyResult(
            name=name,
            title=title,
            with_discrepancy=with_discrepancy,
            quantities=quantities,
            ln_evidence=138.2 + float(np.log(probability or 1e-9)),
            ln_evidence_sd=0.01,
            probability=probability,
            left_out_bands=left_out,
            left_out_bands_sd=None if left_out is None else sd,
            left_out_pareto_k=None if left_out is None else 0.4 + sd / 4,
            chi_square=22.0,
            method="importance sampling",
            pareto_k=0.3,
        )

    return (
        family("zheng2014", "skew-Cauchy (the paper's)", True, 0.12, 140.2, 2.1),
        family("log_normal_wavenumber", "log-normal in wavenumber", True, 0.88, 143.5, 0.0),
        family("zheng2014", "skew-Cauchy (the paper's)", False, None, None, 0.0),
    )


def _residual(band: BandPassFilter, chi_square: float, freedom: int) -> BandResidual:
    """Return how well one filter is explained."""
    p = float(np.clip(np.exp(-chi_square / 6), 0.0, 1.0))
    return BandResidual(
        filter_name=band.name,
        center_nm=band.center_nm,
        chi_square=chi_square,
        degrees_of_freedom=freedom,
        posterior_predictive_p=p,
        explained=p >= 0.01,
        calibration_pull=_estimate(0.3, 0.9),
    )


def _reradiation(mode_nm: float, rng: np.random.Generator) -> Reradiation:
    """Return an absorption that is known at the laser line and believed elsewhere."""
    mean = 1.2 * _bell(EXCITATION_NM, mode_nm - 60.0, 160.0)
    mean = mean / np.interp(LASER_NM, EXCITATION_NM, mean)
    width = 0.3 * np.abs(EXCITATION_NM - LASER_NM) / 50.0 * mean
    return Reradiation(
        excitation_nm=EXCITATION_NM,
        laser_nm=LASER_NM,
        absorption_rel=mean,
        low95=np.maximum(mean - width, 0.0),
        high95=mean + width,
        absorption_rel_draws=np.abs(mean + 0.5 * width * rng.standard_normal((CURVE_DRAWS, 1))),
        stokes_shift_nm=_estimate(38.0, 13.0),
        stokes_shift_draws_nm=38.0 + 13.0 * rng.standard_normal(CURVE_DRAWS),
        measured_at_nm=(LASER_NM,),
        prior_driven=True,
        prior={"stokes_shift_nm": "normal(35, 15) nm above 0; eight measured materials"},
        distinct_shapes=4000,
        rejected_share=0.4,
        violating_share=0.0,
        statement="the Stokes shift comes from the prior: one laser at 450 nm fixes absorption at 450 nm only",
    )


def _diagnostics() -> Diagnostics:
    """Return a trusted importance sample that emcee has checked."""
    return Diagnostics(
        method="importance sampling",
        trusted=True,
        pareto_k=0.31,
        effective_samples=3120.0,
        ln_evidence=138.1,
        ln_evidence_sd=0.01,
        maxima=(142.3, 131.0),
        chain=ChainCheck(
            walkers=64,
            steps=840,
            converged=True,
            acceptance_fraction=0.31,
            autocorrelation_time=dict.fromkeys(SAMPLED, 8.1),
            r_hat=dict.fromkeys(SAMPLED, 1.004),
            effective_samples=dict.fromkeys(SAMPLED, 6350.0),
            mean_shift_sd=dict.fromkeys(SAMPLED, -0.03),
        ),
    )


def _session(name: str) -> CaptureSession:
    """Return a session with a few frames."""
    optics = _optics()
    kinds = ("dark", "white", "reflectance", "fluorescence")
    frames = tuple(
        Frame(
            sequence=i,
            file=f"frames/{i:04d}.tiff",
            frame_type=kinds[i % 4],
            target="white" if kinds[i % 4] == "white" else "sample",
            light="laser" if kinds[i % 4] == "fluorescence" else "lamp",
            filter_name=f"{CENTERS_NM[i % 8]:g}",
            slot_before=i % 8 + 1,
            slot_after=i % 8 + 1,
            exposure_requested_s=0.01 * (i + 1),
            exposure_s=0.01 * (i + 1),
            captured_utc="2026-11-21T20:00:00+00:00",
            saturated_fraction=0.0,
            sha256="0" * 64,
        )
        for i in range(64)
    )
    return CaptureSession(
        plan=PaintPlan(paint_name=name, region=RegionOfInterest(row_px=10, column_px=10, height_px=64, width_px=64)),
        rig=_rig(name),
        camera_response=optics.camera_response,
        lamp=optics.lamp,
        frames=frames,
    )


def _rig(name: str) -> RigFile:
    """Return the simulated rig."""
    paint = HiddenPaint(
        name=name, mode_nm=606.0, fwhm_nm=48.0, asinh_skewness=1.0, energy_yield=0.2, absorption_peak_nm=470.0
    )
    return RigFile(
        name="simulated bench",
        filter_wheel=FilterWheelSettings(filters=_filters()),
        simulated=SimulatedBench(paint=paint),
    )


def _preview(colour: Colour, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return a painted square on grey."""
    image = np.full((60, 80, 3), 120.0)
    image[12:48, 16:64] = {"red": (225.0, 84.0, 62.0), "green": (92.0, 205.0, 88.0)}[colour]
    return np.asarray(np.clip(image + 4 * rng.standard_normal(image.shape), 0, 255), dtype=np.uint8)


def _comparison(rng: np.random.Generator) -> tuple[SimulatedPress, TactileCapture, PhotometricErrorReport]:
    """Return a press of a cylinder across the pad, its capture and their comparison."""
    rows, columns = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX].astype(float)
    distance = np.abs(columns - 0.5 * WIDTH_PX) / 12.0
    fall = np.stack(
        [0.2 + 0.6 * rows / HEIGHT_PX, 0.8 - 0.6 * rows / HEIGHT_PX, 0.3 + 0.5 * _bell(columns, 20.0, 90.0)], 2
    )
    dent = 1 - 0.35 * _bell(distance, 0.0, 1.6) + 0.12 * _bell(distance, 1.5, 0.9)
    real_dent = 1 - 0.38 * _bell(distance, 0.05, 1.5) + 0.10 * _bell(distance, 1.5, 0.9)
    distance[:4] = np.nan
    simulated, captured = fall * dent[..., None], fall * real_dent[..., None]
    matrix = np.array([[0.72, 0.2, 0.01], [0.18, 0.73, 0.08], [0.01, 0.15, 0.91]])
    press = SimulatedPress(
        name="cylinder press",
        label="rendered, level b, llvm_ad_rgb",
        method="rendered",
        encoding="linear",
        no_contact=fall @ matrix.T,
        contact=simulated @ matrix.T,
        distance=distance,
        variance=None,
        bands=("red", "green", "led"),
        camera_matrix=matrix,
        light_angle_deg=30.0,
        design=FingerDesign(),
        notes=("48 samples per pixel; render noise 0.6 % of the mean",),
    )
    capture = TactileCapture(
        name="cylinder press, simulated twin",
        contact=_raw(captured @ matrix.T, rng),
        no_contact=_raw(fall @ matrix.T, rng),
        repeat_no_contact=_raw(fall @ matrix.T, rng),
        layout="Bayer RGGB",
        encoding="linear",
        bit_depth=10,
        black_level_dn=16.0,
        exposure_s=0.02,
        light_angle_deg=30.0,
        indenter=IndenterPose(shape="cylinder", radius_mm=10.0, depth_mm=1.5, position_mm=35.0),
        contact_circle=None,
        mm_per_px=0.3,
        source="simulated bench",
    )
    error = (simulated - captured).mean(axis=2) / fall.mean(axis=2) + 0.003 * rng.standard_normal(distance.shape)
    error[:4] = np.nan
    return press, capture, _report(error)


def _raw(image: Floats, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return an RGGB frame of twice the image's size in counts."""
    height, width = image.shape[:2]
    frame = np.zeros((2 * height, 2 * width, 1))
    for (row, column), channel in {(0, 0): 0, (0, 1): 1, (1, 0): 1, (1, 1): 2}.items():
        frame[row::2, column::2, 0] = image[..., channel]
    counts = 16 + 700 * frame + 3 * rng.standard_normal(frame.shape)
    return np.asarray(np.clip(np.rint(counts), 0, 1023), dtype=np.uint16)


def _report(error: Floats) -> PhotometricErrorReport:
    """Return the comparison's report over contact and halo."""
    return PhotometricErrorReport(
        simulated="cylinder press",
        captured="cylinder press, simulated twin",
        label="rendered, level b, llvm_ad_rgb",
        values="linear light",
        block_px=1,
        headline_region="contact and halo",
        headline_skill=Interval(estimate=0.931, low95=0.913, high95=0.949),
        regions=(_region("contact", 1.0, 2300, 0.957), _region("contact and halo", 2.0, 4600, 0.931)),
        ssim_full_frame={"do nothing": 0.93, "simulation": 0.984, "floor": 0.991},
        ssim_settings="SSIM after Wang 2004 (Gaussian 1.5 px, 11 x 11)",
        exposure_factor=1.034,
        exposure_factor_sd=0.002,
        channel_weights=(1.2, 1.0, 0.8),
        objective_error=ObjectiveError(
            error_rel=Interval(estimate=0.018, low95=0.006, high95=0.03),
            log_ratio_draws=0.018 + 0.006 * np.random.default_rng(5).standard_normal((40, 3)),
            log_exposure_draws=None,
            source="red paint 0000, green paint 1111, camera of the rig",
        ),
        interval_covers="paint posterior, camera, pose, render noise and which part of the region was looked at",
        monte_carlo=MonteCarlo(
            draws=40_000,
            significant_digits=2,
            not_included=("the spectrum of the blue LED, which is nominal", "another press on another day"),
        ),
        budget=_budget(),
        validation=_validation(),
        findings=("no shift between render and capture above 0.3 px was found",),
        light_angle_deg=30.0,
        error_map=error,
        notes=("one capture: the intervals do not know what another press would give",),
    )


def _budget() -> tuple[InputUncertainty, ...]:
    """Return what four inputs add."""
    lines = (
        ("paints", "A", "posterior draws of both paints", 0.006, 0.004),
        ("pose of the indenter", "B", "depth and position of the capture with their uncertainties", 0.011, 0.003),
        ("render noise", "A", "two halves of the samples", 0.002, 0.001),
        ("part of the region that was looked at", "A", "block bootstrap", 0.005, None),
    )
    return tuple(
        InputUncertainty(input=name, evaluation=kind, source=source, skill_u=skill, objective_u_rel=objective)
        for name, kind, source, skill, objective in lines
    )


def _validation() -> tuple[ValidationCell, ...]:
    """Return the level of nine parts in three channels; two of them are outside."""
    cells = []
    for number, channel in enumerate(("red", "green", "blue")):
        for place in range(9):
            error = 0.004 * (place - 4) + 0.002 * number
            outside = channel == "green" and place in {0, 8}
            cells.append(
                ValidationCell(
                    row=place // 3,
                    column=place % 3,
                    channel=channel,
                    pixels=510,
                    error_rel=3 * error if outside else error,
                    u_numerical_rel=0.002,
                    u_input_rel=0.008,
                    u_data_rel=0.004,
                    u_validation_rel=0.0092,
                    within=not outside,
                    area_too_bright_rel=max(error, 0.0),
                    area_too_dark_rel=max(-error, 0.0),
                )
            )
    return tuple(cells)


def _around(value: float) -> dict[str, float]:
    """Return an interval of a tenth to both sides."""
    return {"estimate": value, "low95": 0.9 * value, "high95": 1.1 * value}


def _scored(report: PhotometricErrorReport, skill: float) -> PhotometricErrorReport:
    """Return the report of another simulation of the same press, with one skill everywhere."""
    row = _row("simulation", skill, 0.02, 0.11)
    regions = tuple(
        region.model_copy(update={"rows": (region.rows[0], row, region.rows[2])}) for region in report.regions
    )
    return report.model_copy(update={"headline_skill": row.skill, "regions": regions})


def _region(name: str, factor: float, pixels: int, skill: float) -> RegionError:
    """Return the three rows of a region."""
    return RegionError(
        region=name,
        factor=factor,
        pixels=pixels,
        clipped_fraction=0.0,
        rows=(
            _row("do nothing", 0.0, 0.0, 0.21),
            _row("simulation", skill, 0.018, 0.041),
            _row("floor", 0.9984, 0.0002, 0.006),
        ),
    )


def _row(candidate: str, skill: float, half: float, rms: float) -> ErrorRow:
    """Return one row with a symmetric interval."""
    return ErrorRow.model_validate(
        {
            "candidate": candidate,
            "skill": {"estimate": skill, "low95": skill - half, "high95": skill + half},
            "skill_per_channel": (skill, skill + 0.7 * half, skill - half),
            "relative_rms": tuple(_around(share * rms) for share in (1.0, 0.9, 1.2)),
            "difference_gradient_rms_per_px": _around(0.1 * rms),
            "chromaticity_rms": _around(0.3 * rms),
            "ms_ssim": 0.95 + 0.04 * skill,
            "ciede2000_mean": 40 * rms,
            "ciede2000_p95": 100 * rms,
            "psnr_db": 20.0 - 20 * np.log10(rms / 0.2),
            "ssim": 0.9 + 0.09 * skill,
        }
    )


def _sweep(rng: np.random.Generator, best_deg: float, repeats: int) -> LightAngleSweep:
    """Return a noisy hill over the angle."""
    angles_deg = np.arange(0.0, 121.0, 10.0)
    hill = _hill(angles_deg, best_deg)[:, None] * (1 + 0.008 * rng.standard_normal((angles_deg.size, repeats)))
    values = hill * (1 + 0.05 * rng.standard_normal(repeats))
    return LightAngleSweep(
        name="blue panel",
        objective="mean brightness beside the indenter",
        label="13 angles, level b, half the resolution",
        angles_deg=angles_deg,
        values=values,
        basis=np.ones((angles_deg.size, repeats, 2, 3)),
        bands=("blue", "green", "red"),
        probe_points_mm=np.zeros((2, 3)),
        design=FingerDesign(),
        paints={"red": "0" * 64, "green": "1" * 64},
        other_objectives=(
            AngleObjective(
                name="surface normal",
                meaning="standard uncertainty of the normal of a tilted facet",
                unit="deg",
                larger_is_better=False,
                values=1 / _two_repeats(angles_deg, 62.0),
            ),
            AngleObjective(
                name="uniformity",
                meaning="dimmest over brightest of the untouched pad",
                unit="1",
                larger_is_better=True,
                values=_two_repeats(angles_deg, 36.0),
            ),
        ),
        constraints=AngleConstraints(
            clipped_share=np.where(angles_deg > 100.0, 0.02, 0.0),
            clipped_limit_share=0.001,
            exposure_rel=np.ones(angles_deg.size),
            in_the_way=tuple("skeleton" if angle < 5.0 else "" for angle in angles_deg),
        ),
    )


def _two_repeats(angles_deg: Floats, best_deg: float) -> Floats:
    """Return a hill twice, each with small errors of its own."""
    rng = np.random.default_rng(9)
    return _hill(angles_deg, best_deg)[:, None] * (1 + 0.01 * rng.standard_normal((angles_deg.size, 2)))


def _hill(angle_deg: Floats, best_deg: float) -> Floats:
    """Return a smooth hill with its top at `best_deg`."""
    return np.asarray(0.25 + 0.75 * np.exp(-0.5 * ((angle_deg - best_deg) / 34.0) ** 2))


OTHERS = (
    OtherObjective(
        name="surface normal", best_deg=62.0, loss_rel=0.21, loss_90_rel=(0.17, 0.25), disagrees=True, statement=""
    ),
    OtherObjective(
        name="uniformity", best_deg=36.0, loss_rel=0.01, loss_90_rel=(0.0, 0.03), disagrees=None, statement=""
    ),
)


def example_decision(verdict: str, validated: bool = True) -> LightAngleDecision:
    """Return a decision with the given verdict."""
    grid_deg = np.arange(0.0, 121.0)
    mean = _hill(grid_deg, 32.0)
    statement = AngleStatement(
        p_within_5deg=0.71,
        expected_regret=0.0031,
        regret_95=0.0142,
        equivalent_deg=((25.0, 39.0),),
        p_within_tolerance=0.97,
    )
    assumed = AngleStatement(
        p_within_5deg=0.62, expected_regret=0.057, regret_95=0.24, equivalent_deg=(), p_within_tolerance=0.51
    )
    alone = AngleStatement(
        p_within_5deg=0.93,
        expected_regret=0.0008,
        regret_95=0.0041,
        equivalent_deg=((27.0, 37.0),),
        p_within_tolerance=1.0,
    )
    captures = (
        DecidingCapture(
            captured="cylinder press, simulated twin",
            light_angle_deg=30.0,
            light_angle_uncertainty_deg=0.52,
            error_rel=0.018,
            error_u_rel=0.006,
            value=0.98,
            sd=0.006,
        ),
    )
    return LightAngleDecision.model_validate(
        {
            "objective": "mean brightness beside the indenter",
            "angle_deg": 32.0,
            "angle_simulation_only_deg": 32.0,
            "verdict": verdict,
            "sentence": "32 deg: true optimum within 5 deg with probability 0.71; expected loss 0.3 %, at most 1.4 % "
            "with 95 % probability; 25-39 deg are equivalent within 2 %.",
            "tolerance_rel": 0.02,
            "validated": validated,
            "discrepancy_rel": 0.018 if validated else 0.1,
            "discrepancy_95_rel": (0.006, 0.06) if validated else (0.025, 0.4),
            "captures": captures if validated else (),
            "statement": statement if validated else assumed,
            "statement_simulation_only": alone,
            "grid_deg": grid_deg,
            "mean": mean,
            "mean_simulation_only": mean,
            "low95": mean - 0.035,
            "high95": mean + 0.035,
            "low95_simulation_only": mean - 0.012,
            "high95_simulation_only": mean + 0.012,
            "other_objectives": OTHERS,
            "next_render": AngleProposal(angle_deg=28.0, gain_rel=0.0004, noise_rel=0.008),
            "next_capture": AngleProposal(angle_deg=35.0, gain_rel=0.0021, noise_rel=0.01) if validated else None,
        }
    )
