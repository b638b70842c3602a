"""Capture: from a plan and a rig to a stored session of raw frames."""
