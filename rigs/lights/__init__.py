"""Drivers of lights, one file per make or protocol, and the light that needs no guard."""
