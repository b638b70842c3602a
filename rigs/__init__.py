"""Rigs: device protocols, the simulated bench and the capture of sessions; imports data_schemas only."""
