"""HTML elements whose text is escaped by construction: what a bag says about itself is never markup."""

from __future__ import annotations

from xml.etree import ElementTree

Element = ElementTree.Element
SPACES = "\n\u00a0\u2009\u202f"
LONGEST = 20_000  # characters of one text; a name of megabytes tells nobody more


def element(tag: str, *children: Element | str | None, **attributes: str) -> Element:
    """An element with children; `class_` stands for class, `data_chart` for data-chart; None is left out."""
    node = Element(
        tag, {name.rstrip("_").replace("_", "-"): plain(value) for name, value in attributes.items()}
    )
    last: Element | None = None
    for child in children:
        if isinstance(child, str):
            if last is None:
                node.text = (node.text or "") + plain(child)
            else:
                last.tail = (last.tail or "") + plain(child)
        elif child is not None:
            node.append(child)
            last = child
    return node


def plain(text: str) -> str:
    """The text with what cannot be seen, or turns the reading direction round, made visible."""
    cut = text if len(text) <= LONGEST else text[:LONGEST] + " …"
    return "".join(one if one.isprintable() or one in SPACES else "\ufffd" for one in cut)


def markup(node: Element) -> str:
    """The element as HTML."""
    return ElementTree.tostring(node, encoding="unicode", method="html")


def table(head: list[str], rows: list[list[Element | str]], **attributes: str) -> Element:
    """A table whose first column names its rows; it scrolls by itself where the page is too narrow."""
    body = [element("tr", *(_cell(index, cell) for index, cell in enumerate(row))) for row in rows]
    heads = element("tr", *(element("th", text, scope="col") for text in head))
    whole = element("table", element("thead", heads), element("tbody", *body), **attributes)
    return element("div", whole, class_="wide", tabindex="0", role="region", aria_label="table")


def _cell(index: int, cell: Element | str) -> Element:
    return element("th", cell, scope="row") if index == 0 else element("td", cell)
