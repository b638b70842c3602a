"""Calibration arithmetic, reports, foreign formats and the command line."""
