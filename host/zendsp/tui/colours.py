"""Themes, and trace colours that people with any colour vision can tell apart."""

from __future__ import annotations

from dataclasses import dataclass

from textual.theme import Theme

# From the palette of Okabe and Ito (2008), "Color Universal Design", moved apart by search so that
# every pair stays distinct under full protanopia and deuteranopia (Machado et al. 2009) and keeps a
# contrast of 3:1 against its background (tests/tui/test_scope.py measures both).
DARK = ("#5AD0FA", "#FB7B00", "#42DB91", "#FFF24A", "#C66FA0", "#DB543F", "#8087FF", "#EDF5F3")
LIGHT = ("#0067B6", "#E52521", "#036B45", "#A23B78", "#558124", "#3B32D1", "#2987A8", "#303030")


@dataclass(frozen=True)
class TraceColours:
    """Hexadecimal colours of what the scope draws."""

    traces: tuple[str, ...]
    grid: str
    cursor: str


def trace_colours(theme: Theme) -> TraceColours:
    """The trace colours of a theme: its variables ``trace-1`` … where it has them, else a set for
    dark or light themes.
    """
    base = DARK if theme.dark else LIGHT
    own = theme.variables
    traces = tuple(own.get(f"trace-{k + 1}", colour) for k, colour in enumerate(base))
    grid = own.get("scope-grid", "#6C7680" if theme.dark else "#8A8F94")
    cursor = own.get("scope-cursor", "#FFFFFF" if theme.dark else "#101010")
    return TraceColours(traces, grid, cursor)


THEMES = (
    Theme(
        name="zendsp-night",
        dark=True,
        primary="#4FA8DC",
        secondary="#2CC59B",
        accent="#E69F00",
        foreground="#DDE3E8",
        background="#0E1216",
        surface="#141A20",
        panel="#1C242C",
        success="#2CC59B",
        warning="#E6B422",
        error="#FF6B5E",
        variables={"footer-key-foreground": "#E69F00", "border": "#33414D"},
    ),
    Theme(
        name="zendsp-day",
        dark=False,
        primary="#0A6AA6",
        secondary="#007A5A",
        accent="#B35900",
        foreground="#1B1F23",
        background="#F4F5F6",
        surface="#FCFCFC",
        panel="#E6E9EC",
        success="#00704F",
        warning="#8F6400",
        error="#C0281C",
        variables={"footer-key-foreground": "#B35900", "border": "#B4BCC4"},
    ),
    Theme(
        name="zendsp-contrast",
        dark=True,
        primary="#7FD0FF",
        secondary="#57F0C2",
        accent="#FFD000",
        foreground="#FFFFFF",
        background="#000000",
        surface="#000000",
        panel="#101010",
        success="#57F0C2",
        warning="#FFD000",
        error="#FF8A7A",
        variables={
            "footer-key-foreground": "#FFD000",
            "border": "#A0A0A0",
            "scope-grid": "#8C8C8C",
        },
    ),
)
