"""Radiometry: raw frames become linear, dark-corrected band signals with covariance. No files, no devices."""
