"""The look of the page: that of the report, with room for a list beside the figures."""

from spiral.view.report.style import BLUE, FONT, GREEN, ORANGE, SKY, VERMILION

STYLE = f"""
:root {{ --blue:{BLUE}; --vermilion:{VERMILION}; --orange:{ORANGE}; --green:{GREEN};
  --ink:#1f2328; --soft:#59616b; --line:#e3e6ea; --paper:#ffffff; --ground:#f6f7f9;
  --edge:#767f8a; --well:#e9ecf0; --chip:#e5f1f9; --chip-edge:#9ccbe8; --chip-ink:#004b76;
  --told:#fbf4ef; --fine:#eef8f4; --noted:#fdf8ec; --wrong:#fdf1ea; --plain:#eef0f3;
  --plain-ink:#454c55; --better:#e0f3ea; --better-ink:#00593f; --worse:#fbe3d6;
  --worse-ink:#8a2f00; --hover:#f1f8fd; --ring:#0b5cad; color-scheme:light; }}
@media (prefers-color-scheme:dark) {{
  :root {{ --blue:{SKY}; --ink:#e6e9ed; --soft:#a9b2bd; --line:#343b44; --paper:#1b2026;
    --ground:#12161b; --edge:#8b95a1; --well:#2c333c; --chip:#123349; --chip-edge:#2a6b96;
    --chip-ink:#bfe1f7; --told:#2e231b; --fine:#14291f; --noted:#2c2614; --wrong:#33201a;
    --plain:#2c333c; --plain-ink:#d3d9e0; --better:#113526; --better-ink:#8fe0bb;
    --worse:#47231a; --worse-ink:#ffbfa3; --hover:#18242e; --ring:#8fd0ff; color-scheme:dark; }}
  body {{ --q-primary:{SKY} !important; --q-negative:#ff9b7a !important;
    --q-dark-page:#12161b !important; --q-dark:#1b2026 !important; }}
  .q-btn.bg-primary, .q-btn.bg-primary .q-btn__content {{ color:#06121b !important; }}
  .js-plotly-plot .main-svg {{ filter:invert(1) hue-rotate(180deg); }}
  .js-plotly-plot .main-svg image {{ filter:invert(1) hue-rotate(180deg); }}
  .js-plotly-plot .main-svg .cbfills {{ filter:invert(1) hue-rotate(180deg); }}
  .js-plotly-plot .main-svg .js-fill[style*="rgb(255, 255, 255)"] {{ fill:#dbe0e6 !important; }}
  .js-plotly-plot .modebar-btn path {{ fill:#a9b2bd !important; }}
}}
:focus-visible {{ outline:3px solid var(--ring) !important; outline-offset:2px; }}
.unseen {{ position:absolute; width:1px; height:1px; overflow:hidden; clip-path:inset(50%);
  white-space:nowrap; }}
body {{ font-family:{FONT}; color:var(--ink); background:var(--ground); }}
.nicegui-content {{ padding:0; gap:0; align-items:stretch; }}
.bar {{ position:sticky; top:0; z-index:20; background:var(--paper);
  border-bottom:1px solid var(--line); }}
.bar-inner, .wrap {{ max-width:1360px; margin:0 auto; padding:0 24px; box-sizing:border-box;
  width:100%; }}
.bar-inner {{ display:flex; align-items:center; gap:16px; min-height:56px; flex-wrap:wrap; }}
.mark {{ font-weight:750; letter-spacing:.14em; color:var(--blue); text-decoration:none;
  font-size:17px; }}
.crumb {{ color:var(--soft); font-size:15px; line-height:1.4; font-weight:400; margin:0;
  overflow:hidden; text-overflow:ellipsis;
  white-space:nowrap; flex:1 1 160px; min-width:0; }}
.wrap {{ padding-top:22px; padding-bottom:80px; display:grid; gap:18px; align-content:start;
  grid-template-columns:minmax(0,1fr); }}
.card {{ background:var(--paper); border:1px solid var(--line); border-radius:10px;
  padding:18px 20px; box-sizing:border-box; min-width:0; }}
.card:empty, .wrap > div:empty {{ display:none; }}
.w-full {{ width:100%; box-sizing:border-box; }}
.split {{ display:grid; grid-template-columns:minmax(340px,390px) minmax(0,1fr); gap:18px;
  align-items:start; }}
h1.big {{ font-size:34px; line-height:1.15; font-weight:700; margin:18px 0 2px; }}
h2.head {{ font-size:18px; line-height:1.3; font-weight:650; margin:0 0 8px; }}
.soft {{ color:var(--soft); font-size:14.5px; line-height:1.5; margin:0; overflow-wrap:anywhere; }}
.number {{ font-size:46px; line-height:1.05; font-weight:700; color:var(--blue);
  font-variant-numeric:tabular-nums; }}
.number .words {{ font-size:32px; white-space:nowrap; }}
.number small {{ font-size:20px; white-space:nowrap; color:var(--soft); font-weight:500; }}
.label {{ font-size:13.5px; line-height:1.4; font-weight:400; color:var(--soft); margin:0 0 2px; }}
.chips {{ display:flex; flex-wrap:wrap; gap:6px; margin-top:12px; }}
.chip {{ border-radius:999px; border:1px solid var(--line); padding:2px 11px; font-size:13.5px;
  background:var(--ground); }}
.chip.added {{ background:var(--chip); border-color:var(--chip-edge); color:var(--chip-ink);
  font-weight:600; }}
.sentence {{ border-left:4px solid var(--vermilion); background:var(--told); padding:8px 14px;
  font-size:16.5px; line-height:1.4; border-radius:0 6px 6px 0; }}
.good {{ border-left:4px solid var(--green); background:var(--fine); padding:8px 14px;
  font-size:15.5px;
  line-height:1.4; border-radius:0 6px 6px 0; }}
.note {{ border-left:4px solid var(--orange); background:var(--noted); padding:8px 14px;
  font-size:15px; line-height:1.45; border-radius:0 6px 6px 0; }}
.note b, .trouble b {{ font-weight:650; }}
.trouble {{ border-left:4px solid var(--vermilion); background:var(--wrong); padding:10px 16px;
  font-size:15px; line-height:1.5; border-radius:0 6px 6px 0; overflow-wrap:anywhere; }}
.effect {{ border-top:1px solid var(--line); padding:12px 0 12px; display:grid;
  grid-template-columns:minmax(0,1fr) auto; column-gap:12px; align-items:start; }}
.effect .name {{ font-weight:650; font-size:16px; line-height:1.3; }}
.effect .meaning {{ color:var(--soft); font-size:14px; line-height:1.4; }}
sub {{ font-size:.75em; line-height:0; }}
.formula {{ display:inline-block; }} .own code {{ white-space:nowrap; }}
.effect .evidence {{ font-size:13.5px; color:var(--soft); margin-top:5px; grid-column:1 / -1;
  display:flex; align-items:center; gap:10px; font-variant-numeric:tabular-nums; }}
.effect .evidence span {{ white-space:nowrap; }}
.meter {{ flex:1 1 60px; height:8px; border-radius:4px; background:var(--well); overflow:hidden; }}
.meter i {{ display:block; height:100%; background:var(--soft); border-radius:4px; }}
.first .meter i {{ background:var(--blue); }}
.alias .meter i {{ background:var(--orange); }}
.alike {{ grid-column:1 / -1; margin-top:8px; font-size:14px; line-height:1.45;
  background:var(--noted);
  border-left:4px solid var(--orange); padding:6px 10px; border-radius:0 6px 6px 0; }}
.worse {{ border-left-color:var(--vermilion); background:var(--wrong); }}
#worse {{ margin-top:12px; display:grid; gap:8px; justify-items:start; }}
#plan {{ margin:4px 0 12px; }}
#proposal {{ margin-bottom:10px; }} #proposal.soft {{ padding:0; }}
.caveats {{ margin:8px 0 10px; font-size:14px; }}
.places {{ margin-top:8px; font-size:14px; }}
#absent {{ margin-top:12px; }} #preliminary {{ margin-bottom:4px; }}
.one-line {{ white-space:nowrap; }}
.caveats ul {{ margin:2px 0 0; padding-left:18px; }}
.branches, .branches ul {{ list-style:none; margin:2px 0 0; padding:0; }}
.branches ul {{ padding-left:14px; border-left:2px solid var(--line); margin-left:6px; }}
.branches .q-btn {{ font-weight:500; text-align:left; }}
.branches .here {{ cursor:default; }} .branches .here .q-btn__content {{ font-weight:700;
  color:var(--ink); }}
.branches .on-line {{ font-weight:650; }}
.order {{ margin:0 0 8px; }} .gone {{ margin-top:6px; font-size:13.5px; }}
#horizons {{ margin-top:12px; }} #horizons td, #horizons th {{ padding-right:8px; }}
#horizons td:last-child, #horizons th:last-child {{ padding-right:0; }}
.judged {{ display:inline-block; border-radius:999px; padding:0 8px; font-size:13px;
  font-weight:600; white-space:nowrap; align-self:start; background:var(--plain);
  color:var(--plain-ink); }}
.judged.better {{ background:var(--better); color:var(--better-ink); }}
.judged.worse {{ background:var(--worse); color:var(--worse-ink); border-left:0; }}
.tried {{ display:grid; grid-template-columns:minmax(0,1fr) auto auto; gap:3px 10px;
  font-size:13.5px; color:var(--soft); margin-top:7px; font-variant-numeric:tabular-nums; }}
.effect > .try {{ grid-column:1 / -1; justify-self:start; margin-top:4px; font-weight:500; }}
.effect .q-expansion-item .q-item {{ padding:2px 0; min-height:32px; font-size:13.5px; }}
.signs {{ margin:6px 0 0; padding:4px 10px 4px 24px; border-left:4px solid var(--orange);
  background:var(--noted); font-size:14px; line-height:1.4; }} .sign {{ font-size:13px; }}
.effect > .wide {{ grid-column:1 / -1; }}
.effect .share {{ color:var(--ink); font-weight:600; }}
.working {{ display:flex; align-items:center; gap:14px; padding:8px 0 10px; width:100%; }}
.card.working {{ padding:12px 20px; max-width:560px; }}
.afloat {{ position:fixed; bottom:18px; left:50%; transform:translateX(-50%); z-index:30;
  width:min(560px, 100vw - 32px); box-shadow:0 4px 18px rgb(0 0 0 / .22); }}
.working .words {{ font-size:14.5px; flex:1 1 auto; min-width:0; }} .working .q-btn {{ flex:none; }}
.choices {{ display:grid; grid-template-columns:repeat(auto-fill,minmax(250px,1fr)); gap:12px; }}
.choice {{ text-align:left; cursor:pointer; font:inherit; color:inherit; background:var(--paper);
  border:1px solid var(--line); border-radius:10px; padding:14px 16px; display:flex;
  flex-direction:column; justify-content:flex-start; text-decoration:none; }}
.choice:hover, .choice:focus-visible {{ border-color:var(--blue); box-shadow:0 0 0 2px var(--chip);
  }}
.choice b {{ display:block; font-size:16px; font-weight:650; margin-bottom:3px;
  color:var(--blue); }}
.choice span {{ color:var(--soft); font-size:14px; line-height:1.4; display:block; }}
.drop {{ display:flex; flex-direction:column; gap:3px; border:2px dashed var(--edge);
  cursor:pointer;
  border-radius:10px; padding:26px 20px; text-align:center; align-items:center; }}
.drop:hover, .drop.over, .drop:focus-visible {{ border-color:var(--blue); background:var(--hover);
  }}
.drop b {{ font-size:16px; font-weight:650; color:var(--blue); }}
.drop span {{ color:var(--soft); font-size:14px; }}
.drop input {{ display:none; }}
.drop progress {{ width:min(420px,100%); margin-top:10px; accent-color:var(--blue); }}
#drop-trouble {{ margin-top:12px; scroll-margin:16px; }}
.mapping {{ display:grid; grid-template-columns:minmax(70px,auto) minmax(0,1fr) 88px; gap:8px 10px;
  align-items:center; margin:14px 0 6px; font-size:14.5px; }}
.mapping .soft {{ display:block; font-size:12.5px; line-height:1.2; max-width:80px; }}
.files {{ display:grid; grid-template-columns:minmax(0,1fr) minmax(130px,auto); gap:6px 12px;
  align-items:center; font-size:14.5px; margin-bottom:10px; overflow-wrap:anywhere; }}
.files + .drop, .files ~ div .drop {{ padding:14px 12px; }}
.instruments {{ display:grid; gap:3px; font-size:14px; line-height:1.35; }}
.instruments .q-field {{ margin-bottom:6px; }}
.equations textarea {{ font-family:ui-monospace,monospace; font-size:13px; line-height:1.45;
  white-space:pre; overflow-x:auto; }}
.studies td:last-child {{ padding:0; width:36px; }}
.studies td:nth-child(3), .studies td:nth-child(4) {{ white-space:nowrap; }}
#studies {{ margin-top:10px; }} .dialog {{ width:min(520px,92vw); }}
.own-note {{ margin-top:12px; white-space:pre-wrap; overflow-wrap:anywhere;
  border-left:3px solid var(--line); padding-left:10px; }}
.tour {{ border-color:var(--blue); border-width:2px; }} .tour p {{ margin:0 0 10px;
  font-size:15.5px; line-height:1.5; max-width:100ch; }}
.drags {{ margin:12px 0 4px; border:1px solid var(--line); }}
.stretches {{ display:flex; flex-wrap:wrap; gap:8px; align-items:center; font-size:14px;
  margin:2px 0 6px; }}
.stretches i {{ display:inline-block; width:12px; height:12px; border-radius:3px; opacity:.55;
  margin-right:6px; }}
.stretches .q-field {{ width:92px; }}
#foresight {{ margin-top:10px; }}
.seed {{ display:grid; grid-template-columns:auto minmax(0,1fr); gap:2px 12px; align-items:center;
  margin-bottom:12px; }}
.add-effect {{ display:grid; grid-template-columns:minmax(0,2fr) minmax(0,1fr) auto; gap:8px;
  align-items:center; margin:4px 0 12px; }}
.begun-with {{ color:var(--chip-ink); font-weight:600; }}
.parameters {{ display:grid; align-items:center; gap:6px 14px; font-size:14px;
  grid-template-columns:minmax(140px,1fr) 130px auto auto auto; }}
.sketched {{ margin:4px 0 6px; width:100%; overflow-x:auto; }}
.sketched figure {{ margin:0; overflow:visible; }} .sketched svg {{ display:block; }}
.caption {{ color:var(--soft); font-size:14px; line-height:1.45; max-width:86ch;
  margin:2px 0 14px; }}
.figure-head {{ font-size:16px; line-height:1.4; font-weight:650; margin:10px 0 0; }}
table.plain {{ border-collapse:collapse; font-size:14.5px; width:100%; }}
table.plain th, table.plain td {{ padding:5px 14px 5px 0; text-align:left; vertical-align:top;
  border-bottom:1px solid var(--line); }}
table.plain td.n, table.plain th.n {{ text-align:right; font-variant-numeric:tabular-nums;
  white-space:nowrap; }}
.wide {{ overflow-x:auto; }} #beside .wide {{ max-width:100%; }}
#beside table.plain {{ width:auto; }} #beside table.plain td:first-child {{ min-width:130px; }}
.command {{ display:flex; align-items:start; gap:8px; background:var(--ground); padding:8px 12px; }}
.command > :first-child {{ flex:1 1 auto; min-width:0; }}
.command pre {{ white-space:pre-wrap; overflow-wrap:anywhere; margin:0; font-size:13.5px; }}
.equation td {{ border:0; padding:3px 10px 3px 0; vertical-align:middle; }}
.equation td.owner {{ color:var(--soft); font-size:14px; }}
.q-btn {{ text-transform:none; letter-spacing:0; font-weight:600; }}
.q-btn__content.justify-start {{ text-align:left; }}
.q-tab {{ text-transform:none; letter-spacing:0; min-height:40px; padding:0 5px; }}
.q-tab__label {{ font-size:13px; font-weight:600; }}
.q-tab-panel {{ padding:10px 0 0; }}
.js-plotly-plot {{ width:100%; }}
.bar .soft {{ align-self:center; }}
.bar a.quiet {{ align-self:center; font-weight:600; }}
a.quiet {{ color:var(--blue); text-decoration:none; }}
a.quiet:hover {{ text-decoration:underline; }}
@media (prefers-reduced-motion:reduce) {{ *, *::before, *::after {{
  animation:none !important; transition:none !important; scroll-behavior:auto !important; }} }}
@media (max-width:980px) {{ .split {{ grid-template-columns:minmax(0,1fr); }} }}
@media (max-width:560px) {{
  .add-effect {{ grid-template-columns:minmax(0,1fr); }}
  header.bar {{ position:static; }} .bar {{ top:0 !important; }}
  header .bar-inner {{ padding-top:8px; padding-bottom:8px; row-gap:6px; }}
  .bar-inner, .wrap {{ padding-left:12px; padding-right:12px; }}
  .card {{ padding:14px 13px; }} .number {{ font-size:36px; }} h1.big {{ font-size:27px; }}
  .studies td:nth-child(4), .studies th:nth-child(4) {{ display:none; }} }}
"""
