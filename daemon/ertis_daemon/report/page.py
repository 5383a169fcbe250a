"""One self-contained HTML page: no file beside it, no script, readable on paper."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ertis_driver.errors import ErtisError

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; color: #1a1a1a;
  background: #fff; max-width: 62rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin-bottom: .3rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; margin: .8rem 0; font-size: .88rem; }
caption { text-align: left; color: #555; padding-bottom: .3rem; }
th, td { padding: .25rem .8rem .25rem 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid #e6e6e6; font-variant-numeric: tabular-nums; }
th { font-weight: 600; border-bottom: 1px solid #999; }
.wide { overflow-x: auto; }
.flag { display: inline-block; background: #c8501e; color: #fff; font-weight: 600;
  padding: .1rem .6rem; border-radius: .2rem; }
.note { color: #444; max-width: 48rem; }
p { max-width: 48rem; }
code { font: .85em/1.4 ui-monospace, "DejaVu Sans Mono", monospace; background: #f4f4f4;
  padding: .05rem .25rem; overflow-wrap: anywhere; }
figure { margin: 1rem 0; } figure svg { max-width: 100%; height: auto; }
figcaption { color: #555; font-size: .88rem; max-width: 48rem; }
@media print { body { margin: 0; max-width: none; font-size: 11px; } h2 { break-after: avoid; }
  figure, table { break-inside: avoid; } }
"""

_SAID_OF_SOURCE = {"sim": "simulated", "live": "recorded live", "replay": "replayed"}


@dataclass(slots=True)
class Page:
    """A page that grows from the top; every text given is plain and escaped here."""

    title: str
    parts: list[str] = field(default_factory=list)

    def sources(self, sources: Sequence[str]) -> None:
        """Say first who made the data."""
        said = " + ".join(_SAID_OF_SOURCE.get(one, one) for one in sources)
        more = " echoes: none of this was heard by a real sonar" if said == "simulated" else ""
        self.parts.append(f'<p><span class="flag">{escape(said)}</span>{escape(more)}</p>')

    def heading(self, text: str) -> None:
        """Begin a section."""
        self.parts.append(f"<h2>{escape(text)}</h2>")

    def text(self, text: str) -> None:
        """Add a paragraph."""
        self.parts.append(f'<p class="note">{escape(text)}</p>')

    def code(self, text: str) -> None:
        """Add a line of code."""
        self.parts.append(f"<p><code>{escape(text)}</code></p>")

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> None:
        """Add a table."""
        lines = ['<div class="wide"><table>']
        if caption:
            lines.append(f"<caption>{escape(caption)}</caption>")
        lines.append(
            "<thead><tr>" + "".join(f"<th>{escape(c)}</th>" for c in head) + "</tr></thead>"
        )
        lines += ["<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows]
        lines.append("</table></div>")
        self.parts.append("\n".join(lines))

    def figure(self, svg: str, caption: str) -> None:
        """Add a drawing, as SVG."""
        self.parts.append(f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>")

    def html(self) -> str:
        """The whole page."""
        title = escape(self.title)
        body = "\n".join(self.parts)
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n"
            f"<body>\n<h1>{title}</h1>\n{body}\n</body>\n</html>\n"
        )


def escape(text: str) -> str:
    """As HTML shows it."""
    return html.escape(text, quote=False)


def write_page(page: Page, path: Path) -> None:
    """Write the page in place of what is there.

    Raises
    ------
    ErtisError
        If the disk does not take it.
    """
    try:
        path.write_text(page.html(), encoding="utf-8")
    except OSError as error:
        raise ErtisError(f"cannot write {path}: {error.strerror}") from error
