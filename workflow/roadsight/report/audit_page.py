"""Page of the audit: each site's answer with and without each effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from roadsight.report.files import filled_page
from roadsight.report.wording import label, number, percent, seconds, short

TEMPLATE = "audit.html.j2"
STYLES = ("base.css", "parts.css")
Row = Mapping[str, Any]


def view(row: Row) -> dict[str, Any]:
    """What page and table show of one row."""
    unit = f" {row['unit']}" if row["unit"] else ""
    return {
        "site": row["site"],
        "effect": label(row["effect"]),
        "simulated": row["decision"] == "simulate",
        "quantity": row["quantity"],
        "value": f"{short(row['value'])}{unit}",
        "threshold": f"{number(row['threshold'])}{unit}",
        "found": f"{number(row['found_with'])} / {number(row['found_without'])}",
        "seen": f"{number(row['seen_with'])} / {number(row['seen_without'])}",
        "change": percent(row["change"]),
        "tolerance": percent(row["tolerance"]),
        "right": row["right"],
        "matters": row["change"] > row["tolerance"],
        "seconds": seconds(row["cpu_seconds"]),
    }


def render_page(rows: Sequence[Row], assets: Mapping[str, str], version: str) -> str:
    """HTML of the page; needs nothing else.

    Parameters
    ----------
    rows : of the audit's table. assets : text of the template and the styles.
    """
    sites = dict.fromkeys(row["site"] for row in rows)
    return filled_page(
        TEMPLATE,
        STYLES,
        assets,
        sites={name: [view(row) for row in rows if row["site"] == name] for name in sites},
        wrong=sum(not row["right"] for row in rows),
        decisions=len(rows),
        version=version,
    )


def plain_table(rows: Sequence[Row]) -> str:
    """The same as Markdown."""
    titles = ("Site", "Effect", "Decision", "Measured", "Threshold", "Found", "Seen")
    head = f"| {' | '.join([*titles, 'Change', 'Right', 'CPU'])} |"
    lines = [head, "|---|---|---|--:|--:|--:|--:|--:|---|--:|"]
    for row in map(view, rows):
        decision = "simulated" if row["simulated"] else "skipped"
        cells = (
            *(row["site"], row["effect"], decision, row["value"], row["threshold"]),
            *(row["found"], row["seen"], row["change"]),
            *("yes" if row["right"] else "**no**", row["seconds"]),
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
