"""From stored records to figures and to one self-contained page; the only door to matplotlib and jinja2."""
