"""The light in a finger: from panels through gel, paint and mirror to the camera, by the renderer Mitsuba.

All light is in three bands (red emission, green emission, LED), so a paint is a 3 x 3 matrix diag(rho) + K and the
camera's picture is arithmetic after rendering, RGB = C @ bands: other paints, cameras and white balances need no new
render. Level a is the paper's emitter, b bakes what the painted walls re-emit, c traces it along each path.

`choose_variant` and `open_renderer` find a renderer that runs here; `paint_bands` makes bands of paints; `render_press`
renders a finger without and with contact; `sweep_light_angle` measures probe points over the light angle and
`probe_gradient` differentiates them, for a search of your own (`finray design optimise` learns from values alone);
`pixel_maps` and `camera_view` show what each pixel sees; `render_plain_sensor` renders a classic sensor. Radiance is
relative to the light panel's, lengths are in mm, and each render states its noise.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from sim.optics._angle_sweep import (
        AngleSweep,
        FacetChains,
        facet_chains,
        measure_together,
        sweep_light_angle,
        with_light_angle,
    )
    from sim.optics._calibrated_camera import read_calibration
    from sim.optics._gradients import ProbeGradient, probe_gradient
    from sim.optics._optical_layout import PanelFrame, Window, camera_pose, panel_frame
    from sim.optics._paint_bands import (
        BAND_NAMES,
        NEGLIGIBLE_CONVERSION,
        PaintBands,
        PaintOptics,
        SpectralBand,
        band_mean,
        camera_matrix,
        chain_matrix,
        chain_steps,
        conversion_gains,
        emission_band,
        mix_chains,
        paint_bands,
        require_near_bands,
        require_same_reflectance,
        require_small_reemission,
    )
    from sim.optics._painted_walls import (
        BAKE_SAMPLES,
        FIRST_CHAINS,
        TEXELS_ALONG,
        WALLS,
        Level,
        WallLight,
        bake_walls,
        last_band,
        paper_emission,
    )
    from sim.optics._pixel_maps import CameraView, PixelMaps, camera_view, pixel_maps
    from sim.optics._plain_sensor import (
        GelHeight,
        PlainRender,
        analytic_gel,
        light_colours,
        light_frame,
        pad_grid_mm,
        plain_sensor_integrator,
        plain_sensor_scene,
        render_plain_sensor,
        seen_places_mm,
        sensor_calibration,
        sensor_pose,
    )
    from sim.optics._probes import ProbePaths, SeenPoints, seen_points, tilt_shares, tilted_facets
    from sim.optics._refraction import inner_face, refract_through
    from sim.optics._render import (
        PressRender,
        Progress,
        RenderLevel,
        RenderSettings,
        check_paints,
        open_guide,
        open_scene,
        render_press,
        stream_seed,
    )
    from sim.optics._renderer import (
        SCALAR_VARIANT,
        Preference,
        RendererChoice,
        choose_variant,
        exr_image,
        open_renderer,
    )
    from sim.optics._scene import LoadedScene
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "BAKE_SAMPLES",
    "BAND_NAMES",
    "FIRST_CHAINS",
    "NEGLIGIBLE_CONVERSION",
    "SCALAR_VARIANT",
    "TEXELS_ALONG",
    "WALLS",
    "AngleSweep",
    "CameraView",
    "FacetChains",
    "GelHeight",
    "Level",
    "LoadedScene",
    "PaintBands",
    "PaintOptics",
    "PanelFrame",
    "PixelMaps",
    "PlainRender",
    "Preference",
    "PressRender",
    "ProbeGradient",
    "ProbePaths",
    "Progress",
    "RenderLevel",
    "RenderSettings",
    "RendererChoice",
    "SeenPoints",
    "SpectralBand",
    "WallLight",
    "Window",
    "analytic_gel",
    "bake_walls",
    "band_mean",
    "camera_matrix",
    "camera_pose",
    "camera_view",
    "chain_matrix",
    "chain_steps",
    "check_paints",
    "choose_variant",
    "conversion_gains",
    "emission_band",
    "exr_image",
    "facet_chains",
    "inner_face",
    "last_band",
    "light_colours",
    "light_frame",
    "measure_together",
    "mix_chains",
    "open_guide",
    "open_renderer",
    "open_scene",
    "pad_grid_mm",
    "paint_bands",
    "panel_frame",
    "paper_emission",
    "pixel_maps",
    "plain_sensor_integrator",
    "plain_sensor_scene",
    "probe_gradient",
    "read_calibration",
    "refract_through",
    "render_plain_sensor",
    "render_press",
    "require_near_bands",
    "require_same_reflectance",
    "require_small_reemission",
    "seen_places_mm",
    "seen_points",
    "sensor_calibration",
    "sensor_pose",
    "stream_seed",
    "sweep_light_angle",
    "tilt_shares",
    "tilted_facets",
    "with_light_angle",
]
