"""Acceptance of a rig: from what its devices did to a verdict for each check."""
