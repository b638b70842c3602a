"""Optics of the finger: fluorescent bands, baked walls, scene, path tracer, press renders and light-angle sweeps."""
