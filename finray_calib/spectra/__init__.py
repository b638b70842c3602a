"""Spectral families and the integrals that turn curves into band values. No files, no devices."""
