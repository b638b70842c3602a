"""The simulated rig: paints, bench, sensor and devices; it never imports a fitter's forward model."""
