"""What a browser would fetch, read and draw of a page."""

from html.parser import HTMLParser


class Page(HTMLParser):
    """Texts, tags and links of an HTML document."""

    def __init__(self, document: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.headings: list[str] = []
        self.texts: list[str] = []
        self._open: list[str] = []
        self.feed(document)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._open.append(tag)
        self.links += [value or "" for name, value in attrs if name in LINKING]

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] in ("h1", "h2"):
            self.headings.append(data.strip())
        if self._open and self._open[-1] != "style" and data.strip():
            self.texts.append(data.strip())

    @property
    def text(self) -> str:
        return " ".join(self.texts)

    @property
    def fetched(self) -> list[str]:
        """Links that leave the page: neither data nor a place in it."""
        return [link for link in self.links if not link.startswith(("data:", "#"))]


LINKING = ("src", "href", "xlink:href", "srcset", "action", "poster", "data")
