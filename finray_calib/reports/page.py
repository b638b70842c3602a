"""One self-contained HTML page from a template of this package."""

from jinja2 import Environment, PackageLoader, StrictUndefined

from finray_calib.reports.number_text import unbroken


def render_page(template: str, **values: object) -> str:
    """Return a template filled with values; text is escaped, and a missing value is an error.

    Parameters
    ----------
    template
        File name in the folder of templates.
    values
        What the template names.
    """
    environment = Environment(
        loader=PackageLoader("finray_calib.reports", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["unbroken"] = unbroken
    return environment.get_template(template).render(**values)
