"""Triangle surfaces of the finger, at rest and deformed: what mechanics writes and optics renders."""
