"""Source of the light's firmware (``laser.c``) and how to flash it (``README.md``)."""
