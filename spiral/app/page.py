"""The page of one study: what is missing, Add, and the error falling."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from nicegui import ui

from spiral.app import frame, panels, unseen
from spiral.app.session import Scene, Session, own_name
from spiral.app.study import Turn, turn_place
from spiral.types.errors import SpiralError
from spiral.view.report.evidence import error_falling

FALL_HEIGHT = 500
_TICK = 0.15  # s between looks at the session
_SHOWN = 5  # candidates before "show all"
TABS = (
    ("Measured and model", ("free_run",)),
    ("Where it fails", ("where", "amplitude")),
    ("Missing force", ("missing_force", "surface", "unknown")),
    ("Spectra", ("orbit", "bode", "waterfall", "whirl")),
    ("Residual", ("correlation",)),
    ("Hidden states", ("hidden",)),
    ("Evidence", ("evidence",)),
    ("Model", ("coefficients", "campbell")),
)
_OWN = (
    ("name", "Name", "hardening"),
    ("formula", "Force on the machine", "-k3*x**3"),
    ("shape", "Its gaps and widths, if any (SI)", "w=0.003"),
)
WHERE, MODEL = "Where it fails", "Model"
FALLING = "falling"


@dataclass
class StudyView:
    """One tab of the browser on one study: what it has drawn, so that only what changed is drawn.

    ``parts`` are functions that build a region, with what the region depends on.
    """

    session: Session
    ident: str
    version: int = -1
    drawn: dict[str, Any] = field(default_factory=dict)
    regions: dict[str, ui.element] = field(default_factory=dict)
    tab: str = TABS[0][0]
    every: bool = False
    fall: ui.plotly | None = None
    typed: dict[str, str] = field(default_factory=dict)

    def scene(self) -> Scene:
        """The study as it is now."""
        return self.session.scene(self.ident)

    def look(self) -> None:
        """Draw what has changed since the last look."""
        scene = self.scene()
        if scene.version == self.version:
            return
        self.version = scene.version
        for name, build, depends in self._parts(scene):
            if self.drawn.get(name, _NEVER) == depends:
                continue
            self.drawn[name] = depends
            region = self.regions[name]
            if name != FALLING:  # that curve moves, rather than being drawn anew
                region.clear()
            with region:
                build(scene)

    def again(self, name: str) -> None:
        """Draw a region anew at the next look."""
        self.drawn.pop(name, None)
        self.version = -1
        self.look()

    def _parts(self, scene: Scene) -> list[tuple[str, Callable[[Scene], None], Any]]:
        study, turn = scene.study, scene.study.turn
        busy = scene.busy
        key = None if turn is None else turn.serial
        ranked = turn is not None and turn.candidates is not None
        return [
            ("working", self._working, busy),
            ("trouble", self._trouble, (study.trouble, bool(study.turns or busy))),
            ("hero", self._hero, (key, study.at, len(study.turns), bool(busy), study.noise_floor)),
            (FALLING, self._falling, (tuple(t.serial for t in study.line), study.noise_floor)),
            ("missing", self._missing,
             (key, ranked, bool(busy), scene.contrast, turn.preview if turn else None)),
            ("figures", self._figures,
             None if turn is None else
             (key, turn.figures, turn.sentence, len(turn.equation), bool(turn.figures or busy))),
            ("data", self._data, (len(study.records), key)),
            ("links", self._links,
             None if turn is None else (key, turn.run_id, turn.tracked, turn.untracked,
                                        ranked, key in scene.writing)),
        ]  # fmt: skip

    # --- regions ---------------------------------------------------------------------------------

    def _working(self, scene: Scene) -> None:
        busy = scene.busy
        if busy is None:
            return
        with ui.element("div").classes("working"):
            ui.spinner(size="20px")
            ui.label(f"{busy.what}: {busy.words}" if busy.words else busy.what).classes("words")
            ui.button("Cancel", on_click=self._cancel).props(
                "outline dense color=negative padding='2px 12px'")  # fmt: skip
        ui.linear_progress(busy.share, show_value=False, size="5px").props("instant-feedback")

    def _trouble(self, scene: Scene) -> None:
        error, begun = scene.study.trouble, scene.study.turns or scene.busy
        if not error and not begun:  # its program ended before the first fit
            ui.button(
                "Fit the model as it is", on_click=lambda: self.session.start(self.ident)
            ).props("unelevated")
        if not error:
            return
        with ui.element("div").classes("trouble").props('role="alert"'):
            ui.html(panels.trouble(error), sanitize=False)
            if not scene.study.turns:
                ui.button("Try again", on_click=lambda: self.session.start(self.ident)).props(
                    "flat"
                )

    def _hero(self, scene: Scene) -> None:
        study = scene.study
        ui.html(panels.headline(study), sanitize=False)
        ui.html(panels.chips(study), sanitize=False)
        if study.turn is not None:
            self._step(scene, study.turn)
            units = panels.units(study.records)
            ui.html(panels.channels(study.turn, units), sanitize=False).style("margin-top:10px")
        with ui.row().classes("gap-2").style("margin-top:14px"):
            idle = scene.busy is None
            undo = ui.button("Undo", icon="undo", on_click=lambda: self._move(-1))
            undo.props("outline").set_enabled(idle and study.at > 0)
            if study.at + 1 < len(study.turns):
                later = panels.words(study.turns[study.at + 1].added)
                again = ui.button(f"Redo {later}", icon="redo", on_click=lambda: self._move(1))
                again.props("flat").set_enabled(idle)

    def _step(self, scene: Scene, turn: Turn) -> None:
        """What the last step did to predictions of unseen data; undone with one click."""
        astray, worse = panels.astray(turn), unseen.step(turn)
        if astray or worse:
            with ui.element("div").classes("note worse").props('role="status" id="worse"'):
                for said in filter(None, (astray, worse)):
                    ui.html(said, sanitize=False)
                if turn.added:
                    undo = ui.button("Undo this step", icon="undo")
                    undo.on_click(lambda: self._move(-1)).set_enabled(scene.busy is None)
                    undo.props("unelevated color=primary padding='4px 12px'")
        ui.html(unseen.errors(turn), sanitize=False)

    def _falling(self, scene: Scene) -> None:
        study = scene.study
        rounds = [{**t.result, "round": i} for i, t in enumerate(study.line)]
        result = {"rounds": rounds, "noise_floor": study.noise_floor}
        figure = error_falling(result, least=1)
        if figure is None:
            return
        figure.update_layout(height=FALL_HEIGHT, margin={"l": 60, "r": 16, "t": 44, "b": 48},
                             legend={"x": 1, "xanchor": "right"})  # fmt: skip
        if self.fall is None:
            self.fall = frame.plot(figure.to_plotly_json(), "error-falling")
        else:
            self.fall.update_figure(frame.drawn(figure.to_plotly_json()))

    def _missing(self, scene: Scene) -> None:
        turn = scene.study.turn
        ui.html("<h2 class='head'>What is missing</h2>", sanitize=False)
        if turn is None or turn.candidates is None:
            waiting = scene.busy is not None
            said = "Ranking the effects that may be missing …" if waiting else "Not ranked yet."
            ui.html(f"<p class='soft'>{said}</p>", sanitize=False)
            if turn is not None and not waiting:
                ranked = functools.partial(self.session.rank, self.ident, turn.serial)
                asked = functools.partial(self._ask, ranked)
                ui.button("Rank what may be missing", on_click=asked).props("outline")
            return
        proposes = bool(turn.proposed)
        if not proposes:
            said = panels.ending(scene.study, turn)
            kind = "good" if turn.verdict == "whiteness" else "note"
            ui.html(f"<div class='{kind}' id='ending'>{said}</div>", sanitize=False)
            if panels.learnable(scene.study, turn):
                learn = ui.button("Offer its curve as an effect", on_click=lambda: self._ask(
                    lambda: self.session.learn(self.ident, turn.serial)))  # fmt: skip
                learn.props("outline").style("margin:10px 0").set_enabled(scene.busy is None)
        else:
            self._proposal(scene, turn)
        if turn.candidates:
            ui.html(f"<p class='soft order'>{panels.order(turn)}</p>", sanitize=False)
        few = 0 if turn.verdict == "whiteness" else _SHOWN
        count = len(turn.candidates) if self.every else few
        for found in turn.candidates[:count]:
            self._candidate(scene, turn, found)
        always = {*scene.study.own, *turn.proposed}
        for found in turn.candidates[count:]:
            if {found["effect"], found["effect"].partition("@")[0]} & always:
                self._candidate(scene, turn, found)
        left = len(turn.candidates) - few
        if left > 0:
            said = "Show fewer" if self.every else f"Show {left} {'more' if few else 'candidates'}"
            ui.button(said, on_click=self._toggle).props("flat dense")
        self._own(scene, turn)

    def _proposal(self, scene: Scene, turn: Turn) -> None:
        """What the trial of the proposed effect says; where there was none, a button for it."""
        said, kind = panels.proposal(turn)
        name = {"worse": "note worse", "fine": "good", "trying": "soft"}[kind]
        ui.html(f"<div class='{name}' id='proposal'>{said}</div>", sanitize=False)
        if kind == "trying" and scene.busy is None:
            attempt = functools.partial(self.session.preview, self.ident, turn.proposed[0])
            button = ui.button("Try it on the test record")
            button.on_click(lambda: self._ask(lambda: attempt(turn.serial))).props("outline")

    def _own(self, scene: Scene, turn: Turn) -> None:
        """An effect written as a formula, tested at once; what was typed stays when it is drawn."""
        typed = self.typed
        with ui.expansion("Write an effect of your own", value=bool(typed)).classes("w-full own"):
            ui.html(panels.FORMULA, sanitize=False)
            for key, label, example in _OWN:
                box = ui.input(label, value=typed.get(key, ""), placeholder=example)
                box.on_value_change(functools.partial(self._type, key))
                box.props("outlined dense").classes("w-full").style("margin-top:8px")
                box.on("keydown.enter", lambda: self._invent(turn.serial))
            button = ui.button("Test it", on_click=lambda: self._invent(turn.serial))
            button.props("outline").style("margin-top:10px").set_enabled(scene.busy is None)

    def _type(self, key: str, event: Any) -> None:
        self.typed[key] = event.value or ""

    def _invent(self, serial: int) -> None:
        name, formula, shape = (self.typed.get(key, "") for key, _, _ in _OWN)
        self._ask(lambda: self.session.invent(self.ident, name, formula, serial, shape))

    def _candidate(self, scene: Scene, turn: Turn, found: Any) -> None:
        effect, aliases = found["effect"], tuple(found["aliases"])
        first = effect in turn.proposed
        with ui.element("div").classes("effect first" if first else "effect"):
            ui.html(panels.candidate(found), sanitize=False)
            add = ui.button("Add", on_click=lambda: self._add(effect, turn.serial))
            filled = first and panels.proposal(turn)[1] == "fine"
            add.props("unelevated color=primary" if filled else "outline color=primary")
            add.props["aria-label"] = f"Add {panels.words(effect)}"
            add.set_enabled(scene.busy is None)
            ui.html(panels.evidence(found), sanitize=False).classes("evidence")
            if effect == turn.preview.get("effect"):
                ui.html(unseen.tried(turn.preview["changes"]), sanitize=False).classes("wide")
            if effect in turn.rejected:
                ui.label(f"Refused: {turn.rejected[effect]}").classes("alike")
            if aliases:
                with ui.element("div").classes("alike"):
                    ui.html(panels.alike(aliases), sanitize=False)
                    self._compare_aliases(scene, turn, (effect, *aliases))

    def _compare_aliases(self, scene: Scene, turn: Turn, effects: tuple[str, ...]) -> None:
        if scene.contrast:
            ui.html(panels.contrast(scene.contrast, scene.windows), sanitize=False)
            with ui.row().classes("gap-2").style("margin:8px 0 4px"):
                for effect in effects:
                    add = ui.button(f"Add {panels.words(effect)}")
                    add.on_click(functools.partial(self._add, effect, turn.serial))
                    add.props("outline dense padding='2px 10px'").set_enabled(scene.busy is None)
            return
        compare = ui.button("Compare them", on_click=lambda: self._contrast(effects, turn.serial))
        compare.props("flat dense").set_enabled(scene.busy is None)

    def _figures(self, scene: Scene) -> None:
        turn = scene.study.turn
        if turn is None or not (turn.figures or scene.busy is None):
            said = "Reading, fitting, drawing: figures come in a few seconds."
            ui.html(f"<h2 class='head'>Measured and model</h2><p class='soft'>{said}</p>",
                    sanitize=False)  # fmt: skip
            ui.element("div").style("height:420px")
            return
        have = {name for name, _, _ in turn.figures}
        known = [t for t, names in TABS if have & set(names) or t == MODEL]
        shown = self.tab if self.tab in known else known[0]
        with ui.tabs().props(
            "align=left no-caps outside-arrows mobile-arrows inline-label"
        ) as tabs:
            for title in known:
                ui.tab(title)
        tabs.set_value(shown)
        tabs.on_value_change(self._choose_tab)
        self.regions["tab"] = ui.element("div").style("width:100%")
        self._tab(shown)

    def _choose_tab(self, event: Any) -> None:
        if event.value and event.value != self.tab:
            self.tab = event.value
            self._tab(event.value)

    def _tab(self, title: str) -> None:
        """Only the figures of the chosen tab travel to the browser."""
        turn = self.scene().study.turn
        region = self.regions["tab"]
        region.clear()
        if turn is None:
            return
        with region:
            if title == WHERE and turn.sentence:
                ui.label(turn.sentence).classes("sentence")
            if title == MODEL:
                ui.html(panels.model(turn), sanitize=False).style("width:100%")
            wanted = dict(TABS)[title]
            folder = turn_place(self.session.out, self.ident, turn.serial) / "figures"
            for name, heading, caption in turn.figures:
                if name in wanted:
                    frame.figure(folder / f"{name}.json", name, heading, caption)

    def _data(self, scene: Scene) -> None:
        study = scene.study
        with ui.expansion("The data, and how to do this on the command line").classes("w-full"):
            if study.records:
                ui.html(panels.records(study.records), sanitize=False)
            frame.local_plugins(self.session)
            ui.html("<p class='soft' style='margin:12px 0 4px'>The same from a terminal:</p>",
                    sanitize=False)  # fmt: skip
            frame.code(frame.command(study))

    def _links(self, scene: Scene) -> None:
        frame.links(self.session, scene)

    # --- clicks ----------------------------------------------------------------------------------

    def _add(self, effect: str, serial: int) -> None:
        self.every = False
        if effect.partition("@")[0] == own_name(self.typed.get("name", "")):
            self.typed.clear()  # it is in the model now
        self._ask(lambda: self.session.add(self.ident, effect, serial))

    def _contrast(self, effects: tuple[str, ...], serial: int) -> None:
        self._ask(lambda: self.session.contrast(self.ident, effects, serial))

    def _move(self, by: int) -> None:
        turn = self.scene().study.turn
        if turn is not None:
            self._ask(lambda: self.session.move(self.ident, by, turn.serial))

    def _cancel(self) -> None:
        self.session.cancel(self.ident)

    def _toggle(self) -> None:
        self.every = not self.every
        self.again("missing")

    def _ask(self, what: Callable[[], None]) -> None:
        try:
            what()
        except SpiralError as error:
            frame.refused(error)
        self.look()


_NEVER = object()


def study_page(session: Session, ident: str) -> None:
    """Build the page of one study."""
    try:
        scene = session.scene(ident)
    except SpiralError as error:
        frame.nothing_here(error)
        return
    view = StudyView(session, ident)
    with frame.bar(scene.study.title):
        view.regions["links"] = ui.row().classes("items-center gap-2")
    with frame.progress_bar():
        view.regions["working"] = ui.element("div").style("width:100%")
    with ui.element("main").classes("wrap"):
        view.regions["trouble"] = ui.element("div")
        with ui.element("div").classes("split").style("align-items:stretch"):
            view.regions["hero"] = ui.element("section").classes("card").style("height:100%")
            view.regions[FALLING] = ui.element("section").classes("card")
            view.regions[FALLING].style(f"min-height:{FALL_HEIGHT + 38}px")
        with ui.element("div").classes("split"):
            view.regions["missing"] = ui.element("section").classes("card")
            view.regions["figures"] = ui.element("section").classes("card")
        view.regions["data"] = ui.element("section").classes("card")
    view.look()
    ui.timer(_TICK, view.look)
