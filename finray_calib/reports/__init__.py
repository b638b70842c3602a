"""From stored records to figures, tables, sentences and self-contained pages; the only door to matplotlib and jinja2.

A page is one HTML file with everything inside, the verdict first, readable without scripts; it is made of sections, and
sections of pictures and tables. Every sentence is computed from the records, no number shows more digits than its
interval supports, and equal input gives equal bytes. There is one file for each page, and beside it its figures and its
statements where they fill a file of their own.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.reports._batch_page import PressPictures, batch_lines, batch_page, press_pictures, ranking_figure
    from finray_calib.reports._certificate_page import (
        Certificate,
        certificate_of,
        certificate_page,
        certificate_pdf,
    )
    from finray_calib.reports._check_page import check_report, history_page
    from finray_calib.reports._comparison_figures import error_map_figure, force_figure_png, score_figure
    from finray_calib.reports._comparison_page import comparison_page, skill_number
    from finray_calib.reports._comparison_statements import (
        error_table,
        grid_phrase,
        headline,
        level_a_sentence,
        row_of,
        simulation_sentence,
    )
    from finray_calib.reports._decision_figures import angle_figure, true_value
    from finray_calib.reports._decision_page import (
        decision_numbers,
        decision_page,
        decision_table,
        decision_validation,
        mounting_picture,
        places_part,
        verdict_light,
        verdict_sentence,
        verdict_words,
    )
    from finray_calib.reports._design_study_page import design_study_page, study_text
    from finray_calib.reports._finger_page import finger_page
    from finray_calib.reports._finger_pictures import finger_page_png, pressed_finger_png, untouched_finger_png
    from finray_calib.reports._finger_views import finger_outline
    from finray_calib.reports._fit_figures import (
        emission_figure,
        paint_map_figure,
        spot_sentence,
        spots_note,
        spread_sentence,
    )
    from finray_calib.reports._fit_page import fit_parts, no_emission_page, paint_report
    from finray_calib.reports._fit_statements import model_statement, paint_sentence, signals_table
    from finray_calib.reports._fitted_paint import FittedPaint, PaintTruth, fit_summary
    from finray_calib.reports._images import (
        ByteImage,
        ContactSheet,
        clipped_remark,
        denoised,
        display_remark,
        display_white,
        pad_window,
        raspberry_pi_display,
        require_denoiser,
        sensed_png,
        to_display,
        touch_pair,
    )
    from finray_calib.reports._methods import comparison_methods, decision_methods, fit_methods, methods_part
    from finray_calib.reports._page import (
        Content,
        KeyNumber,
        Light,
        Part,
        Picture,
        PicturePair,
        ReportPage,
        ReportTable,
        drawing,
        figure_png,
        files_table,
        found_part,
        light_of,
        one_group,
        provenance_table,
        raster,
        report_html,
        trust_part,
    )
    from finray_calib.reports._plain_text import (
        Json,
        comparison_lines,
        decimals_for,
        duration,
        fixed,
        force_lines,
        interval_text,
        pareto_text,
        percent,
        plain,
        probability,
        signed_percent,
        significant,
    )
    from finray_calib.reports._record_plots import RecordPlot, plot_record
    from finray_calib.reports._sensor_drawing import sensor_png, sensor_text
    from finray_calib.reports._study_figures import (
        fluorescent_rendering_png,
        light_angle_png,
        paper_paints_png,
        two_lights_png,
    )
    from finray_calib.reports._style import CHANNELS, legend_above, new_figure, styled, svg_text
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "CHANNELS",
    "ByteImage",
    "Certificate",
    "ContactSheet",
    "Content",
    "FittedPaint",
    "Json",
    "KeyNumber",
    "Light",
    "PaintTruth",
    "Part",
    "Picture",
    "PicturePair",
    "PressPictures",
    "RecordPlot",
    "ReportPage",
    "ReportTable",
    "angle_figure",
    "batch_lines",
    "batch_page",
    "certificate_of",
    "certificate_page",
    "certificate_pdf",
    "check_report",
    "clipped_remark",
    "comparison_lines",
    "comparison_methods",
    "comparison_page",
    "decimals_for",
    "decision_methods",
    "decision_numbers",
    "decision_page",
    "decision_table",
    "decision_validation",
    "denoised",
    "design_study_page",
    "display_remark",
    "display_white",
    "drawing",
    "duration",
    "emission_figure",
    "error_map_figure",
    "error_table",
    "figure_png",
    "files_table",
    "finger_outline",
    "finger_page",
    "finger_page_png",
    "fit_methods",
    "fit_parts",
    "fit_summary",
    "fixed",
    "fluorescent_rendering_png",
    "force_figure_png",
    "force_lines",
    "found_part",
    "grid_phrase",
    "headline",
    "history_page",
    "interval_text",
    "legend_above",
    "level_a_sentence",
    "light_angle_png",
    "light_of",
    "methods_part",
    "model_statement",
    "mounting_picture",
    "new_figure",
    "no_emission_page",
    "one_group",
    "pad_window",
    "paint_map_figure",
    "paint_report",
    "paint_sentence",
    "paper_paints_png",
    "pareto_text",
    "percent",
    "places_part",
    "plain",
    "plot_record",
    "press_pictures",
    "pressed_finger_png",
    "probability",
    "provenance_table",
    "ranking_figure",
    "raspberry_pi_display",
    "raster",
    "report_html",
    "require_denoiser",
    "row_of",
    "score_figure",
    "sensed_png",
    "sensor_png",
    "sensor_text",
    "signals_table",
    "signed_percent",
    "significant",
    "simulation_sentence",
    "skill_number",
    "spot_sentence",
    "spots_note",
    "spread_sentence",
    "study_text",
    "styled",
    "svg_text",
    "to_display",
    "touch_pair",
    "true_value",
    "trust_part",
    "two_lights_png",
    "untouched_finger_png",
    "verdict_light",
    "verdict_sentence",
    "verdict_words",
]
