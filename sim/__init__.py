"""The finger: mechanics, optics and the studies that join them."""
