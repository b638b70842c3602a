"""Drivers of filter wheels, one file per make or protocol."""
