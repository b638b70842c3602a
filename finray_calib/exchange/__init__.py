"""Read and write the formats of other programs: every foreign import and export, one file per format.

A calibrated paint is exported as CSV, JSON, netCDF (ArviZ), SPDX, Mitsuba spectrum, reduced RGB matrix or bispectral
OpenEXR, all by name from `PAINT_FORMATS`. Captures of other labs are read from folders of band images, of Raspberry Pi
pictures, of ball presses, of 9DTact or Taxim calibrations; measured force from CSV; renders of any simulator from
folders. Frames of a session are exported as OME-TIFF, NeXus or bluesky documents, captures as one zip archive; renders,
meshes, printable parts, board calibrations, capture requests and acceptance reports are exported as files that other
programs open.

A layout that a recipe can describe (a short TOML file) needs no code. Another format of captures is a function here
and a job of `finray import`; a package outside the tree brings one by an entry point (`ImportFormat`).

What cannot be known from a foreign file is asked for or refused, never guessed; nothing pickled is ever loaded.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.exchange._ball_presses import DATA_PACK, PARAMETERS, read_ball_presses, read_circles, read_taxim
    from finray_calib.exchange._band_folder import import_band_folder
    from finray_calib.exchange._capture_recipe import Recipe, read_recipe, recipe_names, with_sizes
    from finray_calib.exchange._capture_request import PlannedView, capture_request
    from finray_calib.exchange._folder_survey import FolderSurvey, survey_folder
    from finray_calib.exchange._lab_measurements import (
        calibration_yaml,
        read_board_picture,
        read_force_csv,
        signal_template,
    )
    from finray_calib.exchange._learning_dataset import (
        dataset_card,
        index_csv,
        index_parquet,
        parquet_table,
    )
    from finray_calib.exchange._mesh_files import PrintFormat, outline_solid_stl, printable_parts, vtu_bytes
    from finray_calib.exchange._nexus import write_bluesky_documents, write_nexus
    from finray_calib.exchange._nine_dtact import nine_dtact_capture, nine_dtact_prediction
    from finray_calib.exchange._ome_tiff import write_ome_tiff
    from finray_calib.exchange._paint_formats import (
        PAINT_FORMATS,
        ExportOptions,
        as_spectral_distribution,
        inference_data,
    )
    from finray_calib.exchange._paint_reradiation import (
        PaintSpectra,
        assumed_led,
        led_camera_matrix,
        read_bispectral_exr,
    )
    from finray_calib.exchange._raspberry_pi import RaspberryPiOptions, raspberry_pi_capture, read_tuning
    from finray_calib.exchange._recipe_captures import RecipeCaptures, read_by_recipe
    from finray_calib.exchange._record_formats import (
        IMPORT_FORMATS,
        CaptureContainer,
        ImportFormat,
        capture_by_package,
        capture_container,
        junit_xml,
        record_dataset,
        study_dataset,
        study_netcdf,
    )
    from finray_calib.exchange._render_files import (
        press_request,
        read_renders,
        write_optics_folder,
        write_picture_folder,
    )
    from finray_calib.exchange._session_frames import SessionFrames, read_session_frames
    from finray_calib.exchange._signal_table import SignalOptions, import_signal_table
    from finray_calib.exchange._taxim_export import FEWEST_PRESSES, taxim_files
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "DATA_PACK",
    "FEWEST_PRESSES",
    "IMPORT_FORMATS",
    "PAINT_FORMATS",
    "PARAMETERS",
    "CaptureContainer",
    "ExportOptions",
    "FolderSurvey",
    "ImportFormat",
    "PaintSpectra",
    "PlannedView",
    "PrintFormat",
    "RaspberryPiOptions",
    "Recipe",
    "RecipeCaptures",
    "SessionFrames",
    "SignalOptions",
    "as_spectral_distribution",
    "assumed_led",
    "calibration_yaml",
    "capture_by_package",
    "capture_container",
    "capture_request",
    "dataset_card",
    "import_band_folder",
    "import_signal_table",
    "index_csv",
    "index_parquet",
    "inference_data",
    "junit_xml",
    "led_camera_matrix",
    "nine_dtact_capture",
    "nine_dtact_prediction",
    "outline_solid_stl",
    "parquet_table",
    "press_request",
    "printable_parts",
    "raspberry_pi_capture",
    "read_ball_presses",
    "read_bispectral_exr",
    "read_board_picture",
    "read_by_recipe",
    "read_circles",
    "read_force_csv",
    "read_recipe",
    "read_renders",
    "read_session_frames",
    "read_taxim",
    "read_tuning",
    "recipe_names",
    "record_dataset",
    "signal_template",
    "study_dataset",
    "study_netcdf",
    "survey_folder",
    "taxim_files",
    "vtu_bytes",
    "with_sizes",
    "write_bluesky_documents",
    "write_nexus",
    "write_ome_tiff",
    "write_optics_folder",
    "write_picture_folder",
]
