"""Pages before they are rendered: data, table and template; and links between them."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlencode

import numpy as np
from markupsafe import Markup

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Page:
    """A page before it is rendered as HTML, JSON or CSV.

    Attributes:
        template: File name of its template.
        path: Address without the leading slash and without an ending.
        title: Title of the page.
        data: Makes the content of the JSON twin.
        frame: Makes the table of the CSV twin, with units in `attrs["units"]`.
        context: Further variables of the template.
        chart_data: Data of the charts that scripts draw [SI]; None of a page without charts.
        query: Part of the query that its twins need too.
    """

    template: str
    path: str
    title: str
    data: Callable[[], Mapping[str, Any]]
    frame: Callable[[], "pd.DataFrame"]
    context: Mapping[str, Any] = field(default_factory=dict)
    chart_data: Mapping[str, Any] | Markup | None = None
    query: Mapping[str, str] = field(default_factory=dict)

    def json(self) -> str:
        """Write the JSON twin: SI units, null for missing values."""
        return json.dumps(plain(self.data()), indent=1, allow_nan=False)

    def csv(self) -> str:
        """Write the CSV twin: SI units in the headings, empty cells for missing values."""
        return with_units(self.frame()).to_csv(index=False) or ""


def with_units(frame: "pd.DataFrame") -> "pd.DataFrame":
    """Copy of a table with the units of its columns (`attrs["units"]`) in their headings."""
    units = frame.attrs.get("units", {})
    return frame.rename(columns={name: f"{name} [{units[name]}]" for name in frame if units.get(name)})


def plain(value: Any) -> Any:
    """Convert a value for JSON: NaN and infinities become None, arrays lists."""
    kind = type(value)  # most values are of one of these types
    if kind is float:
        return value if math.isfinite(value) else None
    if kind is str or kind is int or kind is bool or value is None:
        return value
    if kind is dict or isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if kind is list or kind is tuple or isinstance(value, set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    return plain(float(value)) if isinstance(value, float) else str(value)


def embedded(data: Any) -> Markup:
    """Data for scripts within a page: JSON that cannot close its HTML element. Markup is returned as it is."""
    if isinstance(data, Markup):
        return data
    text = json.dumps(plain(data), allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def records(frame: "pd.DataFrame") -> list[dict[str, Any]]:
    """Rows of a frame by column; None for missing values, since templates take NaN for true."""
    return frame.astype(object).where(frame.notna(), None).to_dict(orient="records")


class Links:
    """Addresses of pages in a running app, escaped."""

    static = False

    def at(self, path: str, query: Mapping[str, Any] | None = None) -> str:
        """The address of the page at a path."""
        parameters = {name: value for name, value in (query or {}).items() if value not in (None, "")}
        return f"/{quote(path)}" + (f"?{urlencode(parameters)}" if parameters else "")

    def file(self, path: str) -> str:
        """The address of a file that is sent as it is."""
        return f"/{quote(path)}"

    def twin(self, page: Page, ending: str) -> str:
        """The address of the same page as `json` or `csv`."""
        return self.at(f"{page.path or 'index'}.{ending}", page.query)

    def study(self, name: str, **query: Any) -> str:
        """The page of a study."""
        return self.at(f"study/{name}", query)

    def point(self, name: str, number: int, **query: Any) -> str:
        """The page of a point of a study; points count from 1."""
        return self.at(f"study/{name}/point/{number}", query)

    def explore(self, name: str, **query: Any) -> str:
        """The page that explores a study."""
        return self.at(f"study/{name}/explore", query)

    def run(self, key: str) -> str:
        """The page of a run, addressed by the first digits of its key."""
        return self.at(f"run/{key[:16]}")

    def runs(self, **query: Any) -> str:
        """The list of runs that pass the filters of a query."""
        return self.at("runs", query)

    def asset(self, name: str) -> str:
        """A static file of the app."""
        return self.file(f"static/{name}")


@dataclass(frozen=True)
class FileLinks(Links):
    """Addresses of the same pages as files in a folder, relative to the page at `path`.

    Pages that need a server have an empty address.

    Attributes:
        path: Path of the page that has the links.
        have: Paths of the pages in the folder.
    """

    path: str
    have: frozenset[str]
    static = True

    def at(self, path: str, query: Mapping[str, Any] | None = None) -> str:
        name = path or "index"
        if name not in self.have:
            return ""
        return self.file(f"{name}.html")

    def file(self, path: str) -> str:
        return "../" * self.path.count("/") + quote(path)

    def twin(self, page: Page, ending: str) -> str:
        return self.file(f"{page.path or 'index'}.{ending}")
