"""Drivers of cameras, one file per make or protocol."""
