"""A template, words and figures → one page that loads nothing: plotly.js and all data inside."""

from __future__ import annotations

from typing import Any

from ftcal.plots import POINTS
from ftcal.report.album import Album
from ftcal.report.words import TEXT_FILTERS


def rendered(template: str, album: Album, **words: Any) -> str:
    """Return the page that a template of `ftcal/templates` makes of `words` and an album.

    Text is escaped; a name that the template uses and `words` lack is an error.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from plotly.offline import get_plotlyjs

    environment = Environment(
        loader=PackageLoader("ftcal", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(TEXT_FILTERS)
    return environment.get_template(template).render(
        **words, points=POINTS, figures=album.json(), plotly=get_plotlyjs()
    )
