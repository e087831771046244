"""Pages from the templates of this folder: values are escaped, and pages need no network."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from leanboom import __version__

if TYPE_CHECKING:
    from jinja2 import Environment

FOLDER = Path(__file__).parent / "templates"


@cache
def templates() -> Environment:
    """The templates: HTML is escaped, Markdown is not; a name without a value is an error; `number` formats."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

    environment = Environment(
        loader=FileSystemLoader(FOLDER),
        autoescape=select_autoescape(disabled_extensions=["md.j2"], default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    environment.filters["number"] = format
    return environment


def page(name: str, data: dict[str, Any], **facts: Any) -> str:
    """An HTML page with its script, style and plotting library inside.

    Args:
        name: Of its template.
        data: What its script draws, ready for JSON.
        facts: What the template names.

    Returns:
        The document's text.
    """
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    template = templates().get_template(f"{name}.html.j2")
    return template.render(data=data, plotly=Markup(get_plotlyjs()), version=__version__, **facts)
