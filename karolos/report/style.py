"""The page's style sheet: light and dark, wide and narrow."""

from __future__ import annotations

from .chart import DARK, DASHES, LIGHT

_COLOURS = "\n".join(f".c{place}{{--ink:var(--c{place})}}" for place in range(len(LIGHT)))
_DASHES = "\n".join(f".d{place}{{stroke-dasharray:{dash}}}" for place, dash in enumerate(DASHES) if dash)


def _variables(colours: tuple[str, ...]) -> str:
    return ";".join(f"--c{place}:{colour}" for place, colour in enumerate(colours))


def style(contenders: int) -> str:
    """The rules for a page of so many contenders; their check boxes e0, e1 ... hide what is theirs."""
    hidden = "\n".join(f"body:has(#e{place}:not(:checked)) .s{place}{{display:none}}" for place in range(contenders))
    return f"{_BASE}{_COLOURS}\n{_DASHES}\n{hidden}\n"


_BASE = f"""
:root{{color-scheme:light dark;--text:#1c1c1c;--soft:#5c5c5c;--ground:#ffffff;--panel:#f6f6f4;--rule:#d9d9d4;
--warn:#fff3d6;{_variables(LIGHT)}}}
@media (prefers-color-scheme:dark){{:root{{--text:#e8e8e6;--soft:#a8a8a4;--ground:#16181b;--panel:#1f2226;
--rule:#3a3e44;--warn:#3d3315;{_variables(DARK)}}}}}
*{{box-sizing:border-box}}
body{{margin:0 auto;padding:1rem;max-width:78rem;background:var(--ground);color:var(--text);
font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Liberation Sans",sans-serif}}
h1{{font-size:1.5rem;line-height:1.25;margin:.5rem 0;overflow-wrap:anywhere}}
h2{{font-size:1.2rem;margin:2.2rem 0 .6rem}}
h3{{font-size:1rem;margin:0 0 .3rem;overflow-wrap:anywhere}}
p,figcaption,.notes{{color:var(--soft);margin:.3rem 0;max-width:65rem}}
.warnings{{background:var(--warn);border-radius:6px;padding:.6rem 1rem .6rem 2rem;margin:1rem 0;overflow-wrap:anywhere}}
.keys{{display:flex;flex-wrap:wrap;gap:.3rem 1.2rem;margin:1rem 0;padding:.5rem 0;position:sticky;top:0;z-index:1;
background:var(--ground);border-bottom:1px solid var(--rule)}}
.keys label{{display:inline-flex;gap:.4rem;align-items:center;cursor:pointer;overflow-wrap:anywhere}}
.keys svg{{width:26px;height:10px;flex:none}}
.figures{{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,30rem),1fr));gap:1.2rem}}
figure{{margin:0;padding:.8rem;background:var(--panel);border-radius:8px;min-width:0}}
figure svg{{display:block;width:100%;height:auto;max-width:42rem}}
figcaption,.notes{{font-size:.85rem}}
.notes{{padding-left:1.1rem}}
.scroll{{overflow-x:auto}}
table{{border-collapse:collapse;font-size:.9rem;font-variant-numeric:tabular-nums}}
th,td{{padding:.3rem .7rem;text-align:left;vertical-align:top;border-bottom:1px solid var(--rule)}}
thead th{{border-bottom:2px solid var(--rule)}}
tbody th,thead th:first-child{{position:sticky;left:0;background:var(--ground)}}
tbody th{{font-weight:normal;color:var(--soft)}}
th,td{{overflow-wrap:break-word;max-width:24rem}}
td{{min-width:5rem}}
td.long{{white-space:pre-line;min-width:6rem}}
@media (max-width:40rem){{td:not(.long){{white-space:nowrap}}tbody th{{max-width:8rem}}}}
td.number{{white-space:nowrap}}
.swatch{{display:inline-block;width:.7em;height:.7em;border-radius:50%;background:var(--ink);margin-right:.4em}}
svg text{{fill:var(--soft);font:13px system-ui,-apple-system,"Segoe UI",Roboto,"Liberation Sans",sans-serif}}
svg .middle{{text-anchor:middle}}
svg .end{{text-anchor:end}}
svg .label{{fill:var(--ink);font-weight:600}}
svg .grid{{stroke:var(--rule);stroke-width:1}}
svg polyline{{fill:none;stroke:var(--ink);stroke-linejoin:round}}
svg .seed{{stroke-width:1;opacity:.38}}
svg .seed:hover{{stroke-width:3;opacity:1}}
svg .main{{stroke-width:2.6}}
svg .edge{{stroke-width:1;opacity:.8}}
svg .band{{fill:var(--ink);opacity:.16;stroke:none}}
svg .dots path{{stroke:var(--ink);stroke-width:7;stroke-linecap:round;stroke-dasharray:none;opacity:.75}}
svg .shades rect{{shape-rendering:crispEdges}}
svg .shades stop{{stop-color:var(--ink)}}
body:has(#seeds:not(:checked)) .seed{{display:none}}
@media (min-width:70rem){{svg text{{font-size:11.5px}}}}
@media (max-width:40rem){{.keys{{position:static}}body{{padding:.7rem}}figure{{padding:.5rem}}}}
@media print{{.keys{{position:static}}figure{{break-inside:avoid}}}}
"""
