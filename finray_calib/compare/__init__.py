"""Compare a simulated press with its capture: skill over declared regions, with floor and interval."""
