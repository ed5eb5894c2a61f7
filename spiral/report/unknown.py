"""The curve of a force that no effect with a name explains."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from spiral.report.style import BLUE, GREY, SKY, blank

if TYPE_CHECKING:
    import plotly.graph_objects as go


def curves(result: Mapping[str, Any]) -> go.Figure | None:
    """Force against state with its simultaneous 95 % band, one panel for each axis."""
    found = result.get("unknown")
    if not found:
        return None
    panels = found["curves"]
    figure = blank(1, len(panels), 430, horizontal_spacing=0.12)
    for column, c in enumerate(panels, 1):
        shown = column == 1
        top = [f + b for f, b in zip(c["force"], c["band"], strict=True)]
        low = [f - b for f, b in zip(c["force"], c["band"], strict=True)]
        size = 0.25 * (max(top) - min(low)) / max(c["visited"])
        figure.add_bar(
            x=c["at"], y=[size * v for v in c["visited"]], base=min(low), marker_color=GREY,
            opacity=0.35, name="visited", showlegend=shown, hoverinfo="skip", row=1, col=column,
        )  # fmt: skip
        figure.add_scatter(
            x=[*c["at"], *c["at"][::-1]], y=[*top, *low[::-1]], fill="toself", fillcolor=SKY,
            opacity=0.35, line={"width": 0}, name="95 % band", showlegend=shown, hoverinfo="skip",
            row=1, col=column,
        )  # fmt: skip
        figure.add_scatter(
            x=c["at"], y=c["force"], name="force", line={"color": BLUE, "width": 3},
            showlegend=shown, row=1, col=column,
        )  # fmt: skip
        figure.update_xaxes(title_text=f"{c['state']} ({found['state_unit']})", row=1, col=column)
    figure.update_yaxes(title_text=f"force ({found['force_unit']})", row=1, col=1)
    return figure
