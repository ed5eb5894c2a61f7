"""The page of one study: what is missing, Add, and the error falling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from nicegui import ui

from spiral.app import branches, frame, horizon_errors, panels, python_text, studies, tour
from spiral.app.address import Address, format_address
from spiral.app.figures import Figures
from spiral.app.missing import OWN, CandidateList
from spiral.app.narrow import is_narrow, watch_width
from spiral.app.press import Press
from spiral.app.session import LiveStudy, Session
from spiral.app.side_by_side import NAME, SideBySide
from spiral.app.study import StudyState
from spiral.app.tab_row import TabRow
from spiral.types.errors import SpiralError
from spiral.view.report.evidence import error_falling

FALL_HEIGHT = 500
WIDE_FALL, NARROW_FALL = 700, 250  # pixels of its axes, in a wide and a narrow window
_TICK = 0.15  # s between looks at the session
TABS = (
    ("Measured and model", ("free_run",)),
    ("Where it fails", ("where", "amplitude")),
    ("Missing force", ("missing_force", "surface", "unknown", "memory")),
    ("Spectra", ("orbit", "bode", "polar", "waterfall", "whirl")),
    ("Residual", ("correlation",)),
    ("Hidden states", ("hidden",)),
    ("Evidence", ("evidence",)),
    ("Model", ("coefficients", "campbell")),
)
WHERE, MODEL = "Where it fails", "Model"
FALLING, WORKING, FIGURES, PANEL = "falling", "working", "figures", "figures-panel"
FALLING_SAID = "Free-run errors of fit and test after each step, with the noise floor"


@dataclass(frozen=True)
class _Progress:
    """The line of words and the bar that tell how far the work has come."""

    words: ui.label
    bar: ui.linear_progress


@dataclass
class StudyView:
    """One tab of the browser on one study: what it has drawn, so that only what changed is drawn.

    ``drawn`` holds, by region, what it depended on when it was drawn last.
    """

    session: Session
    ident: str
    at: Address
    version: int = -1
    drawn: dict[str, Any] = field(default_factory=dict)
    regions: dict[str, ui.element] = field(default_factory=dict)
    tab: str = TABS[0][0]
    told: str = ""
    fall: ui.plotly | None = None
    said: ui.label | None = None
    progress: _Progress | None = None
    press: Press = field(default_factory=Press)
    tabs: TabRow | None = None

    def __post_init__(self) -> None:
        self.client = ui.context.client
        self.tab = self.at.tab or self.tab
        views = {name: dict(view) for name, view in self.at.views.items()}
        self.figures = Figures(self.session, self.ident, self._update_address, views)
        self.beside = SideBySide(
            self.figures, lambda: self.redraw("beside"), self._update_address, self.at.beside
        )
        self.missing = CandidateList(
            self.session, self.ident, self._run_or_notify, lambda: self.redraw("missing")
        )

    def scene(self) -> LiveStudy:
        """The study as it is now."""
        return self.session.scene(self.ident)

    def refresh(self) -> None:
        """Draw what has changed since the last look, once no mouse button is down.

        Away, where the study was deleted.
        """
        if not self.session.is_loaded(self.ident):
            with self.client:
                ui.navigate.to("/")
            return
        scene = self.scene()
        if scene.version == self.version or self.press.is_held():
            return
        self.version = scene.version
        for name, build, depends in self._region_builders(scene):
            if self.drawn.get(name, _NEVER) == depends:
                continue
            self.drawn[name] = depends
            region = self.regions[name]
            if name not in (FALLING, WORKING, FIGURES):  # these are updated in place
                region.clear()
            with region:
                build(scene)
        self._update_address()

    def _update_address(self) -> None:
        """Have the browser's address say what this tab looks at."""
        turn = self.scene().study.turn
        views = {k: v for k, v in self.figures.views.items() if k in self._shown_figures()}
        serial = None if turn is None else turn.serial
        said = format_address(Address(serial, self.tab, views, self.beside.address()))
        if said != self.told:
            self.told = said
            with self.client:  # what was clicked may have been drawn anew meanwhile
                ui.navigate.history.replace(said)

    def _shown_figures(self) -> tuple[str, ...]:
        """Names of the figures that this tab shows."""
        return (*dict(TABS).get(self.tab, ()), NAME)

    def redraw(self, *names: str) -> None:
        """Draw regions anew at the next look."""
        for name in names:
            self.drawn.pop(name, None)
        self.version = -1
        self.refresh()

    def _region_builders(
        self, scene: LiveStudy
    ) -> list[tuple[str, Callable[[LiveStudy], None], Any]]:
        study, turn = scene.study, scene.study.turn
        busy = scene.busy
        key = None if turn is None else turn.serial
        ranked = turn is not None and turn.candidates is not None
        candidates = (key, ranked, bool(busy), scene.contrast, scene.plan, scene.scored)
        if turn is None:
            trials, figures, links = None, None, study.title
        else:
            trials = turn.trials
            shown = bool(turn.figures or busy)
            figures = (key, turn.figures, turn.sentence, len(turn.equation), shown)
            tracked = (turn.run_id, turn.tracked, turn.untracked)
            links = (study.title, key, tracked, ranked, key in scene.writing)
        headline = (key, study.at, len(study.turns), bool(busy), study.noise_floor, study.note)
        line = tuple(t.serial for t in study.line)
        return [
            (WORKING, self._draw_progress, busy),
            ("tour", self._draw_tour, (study.tour, key, ranked, bool(busy))),
            ("trouble", self._draw_trouble, (study.trouble, bool(study.turns or busy))),
            ("hero", self._draw_headline, headline),
            (FALLING, self._draw_error_curve, (line, study.noise_floor)),
            ("missing", self.missing.build, (candidates, trials, study.trouble)),
            (FIGURES, self._draw_figure_tabs, figures),
            ("beside", self.beside.build, tuple(t.serial for t in study.turns)),
            ("data", self._draw_data, (len(study.records), key, turn.run_id if turn else "")),
            ("links", self._draw_links, links),
        ]

    # --- regions ---------------------------------------------------------------------------------

    def _draw_progress(self, scene: LiveStudy) -> None:
        """What is under way; its button is never replaced, as a click on one just gone is lost."""
        busy = scene.busy
        if busy is None:
            self.regions[WORKING].clear()
            self.progress = None
            return
        if self.progress is None:
            self.progress = self._begin_progress()
        self.progress.words.set_text(panels.progress_words(busy.what, busy.words, busy.lasted))
        self.progress.bar.set_value(busy.share)

    def _begin_progress(self) -> _Progress:
        with ui.element("div").classes("working"):
            ui.spinner(size="20px")
            words = ui.label("").classes("words")
            ui.button("Cancel", on_click=self._cancel_order).props(
                "outline dense color=negative padding='2px 12px'")  # fmt: skip
        bar = ui.linear_progress(0.0, show_value=False, size="5px").props("instant-feedback")
        bar.props["aria-label"] = "How far this step has come"
        return _Progress(words, bar)

    def _draw_tour(self, scene: LiveStudy) -> None:
        turn = scene.study.turn
        serial = 0 if turn is None else turn.serial

        def show_where() -> None:
            self.tab = WHERE
            self.redraw(FIGURES)

        tour.draw_tour_step(
            scene,
            show_where,
            lambda e: self._run_or_notify(lambda: self.session.add(self.ident, e, serial)),
        )

    def _draw_trouble(self, scene: LiveStudy) -> None:
        """The last message; one about an own formula stands beside its field."""
        error, begun = scene.study.trouble, scene.study.turns or scene.busy
        if not error and not begun:  # its program ended before the first fit
            ui.button(
                "Fit the model as it is", on_click=lambda: self.session.start(self.ident)
            ).props("unelevated")
        if not error or (error.get("at") == OWN and begun):
            return
        with frame.error_box(error):
            if not scene.study.turns:
                ui.button("Try again", on_click=lambda: self.session.start(self.ident)).props(
                    "flat"
                )

    def _draw_headline(self, scene: LiveStudy) -> None:
        study = scene.study
        ui.html(panels.headline(study), sanitize=False)
        if self.said is not None and study.turn is not None:
            self.said.set_text(panels.error_announcement(study.turn))
        ui.html(panels.effect_chips(study), sanitize=False)
        if study.turn is not None:
            self._draw_step_change(scene, study.turn)
            units = panels.series_units(study.records)
            ui.html(panels.channel_error_table(study.turn, units), sanitize=False).style(
                "margin-top:10px"
            )
        branches.draw_undo_redo(scene, self._select_turn)
        branches.draw_branch_tree(scene, self._select_turn)
        if study.note:
            ui.label(study.note).classes("soft own-note").props["id"] = "note"

    def _draw_step_change(self, scene: LiveStudy, turn: StudyState) -> None:
        """What the last step did to predictions of unseen data; undone with one click."""
        astray, worse = panels.divergence_warning(turn), horizon_errors.worse_step_note(turn)
        if astray or worse:
            with ui.element("div").classes("note worse").props('role="status" id="worse"'):
                for said in filter(None, (astray, worse)):
                    ui.html(said, sanitize=False)
                if turn.added:
                    undo = ui.button("Undo this step", icon="undo")
                    undo.on_click(lambda: self._select_turn(turn.parent)).set_enabled(
                        scene.busy is None
                    )
                    undo.props("unelevated color=primary padding='4px 12px'")
        ui.html(horizon_errors.horizon_error_table(turn), sanitize=False)

    def _draw_error_curve(self, scene: LiveStudy) -> None:
        study = scene.study
        rounds = [{**t.result, "round": i} for i, t in enumerate(study.line)]
        result = {"rounds": rounds, "noise_floor": study.noise_floor}
        narrow = is_narrow()
        width = NARROW_FALL if narrow else WIDE_FALL
        figure = error_falling(result, least=1, width=width, height=FALL_HEIGHT)
        if figure is None:
            return
        figure.update_layout(margin={"l": 60, "r": 16, "t": 44, "b": 48})
        if narrow:
            figure.update_annotations(font_size=12)
        if self.fall is None:
            self.fall = frame.draw_plot(figure.to_plotly_json(), "error-falling", FALLING_SAID)
        else:
            self.fall.update_figure(frame.responsive_figure(figure.to_plotly_json()))

    def _draw_figure_tabs(self, scene: LiveStudy) -> None:
        """Tabs of figures, each kept as others come: a click on one just replaced is lost."""
        turn = scene.study.turn
        if turn is None or not (turn.figures or scene.busy is None):
            self.regions[FIGURES].clear()
            self.tabs = None
            said = "Reading, fitting, drawing: figures come in a few seconds."
            ui.html(f"<h2 class='head'>Measured and model</h2><p class='soft'>{said}</p>",
                    sanitize=False)  # fmt: skip
            ui.element("div").style("height:420px")
            return
        have = {name for name, _, _ in turn.figures}
        known = [t for t, names in TABS if have & set(names) or t == MODEL]
        shown = self.tab if self.tab in known else known[0]
        if self.tabs is None:
            self.regions[FIGURES].clear()
            self.tabs = self._begin_figure_tabs()
        self.tabs.show(known, shown)
        self._draw_tab(shown)

    def _begin_figure_tabs(self) -> TabRow:
        ui.html("<h2 class='unseen'>Figures</h2>", sanitize=False)
        tabs = TabRow(PANEL, self._choose_tab)
        panel = ui.element("div").style("width:100%").props('role="tabpanel" tabindex="0"')
        panel.props["id"] = PANEL
        self.regions[PANEL] = panel
        return tabs

    def _choose_tab(self, title: str) -> None:
        self.tab = title
        self._draw_tab(title)
        self._update_address()

    def _draw_tab(self, title: str) -> None:
        """Only the figures of the chosen tab travel to the browser."""
        turn = self.scene().study.turn
        region = self.regions[PANEL]
        region.props["aria-label"] = title
        region.clear()
        if turn is None:
            return
        with region:
            if title == WHERE and turn.sentence:
                calm = "level of the noise everywhere" in turn.sentence
                ui.label(turn.sentence).classes("good" if calm else "sentence")
            if title == MODEL:
                self.figures.draw_model_sketch(turn.serial)
                ui.html(panels.model_table(turn), sanitize=False).style("width:100%")
            for name, heading, caption in turn.figures:
                if name in dict(TABS)[title]:
                    self.figures.show_figure(turn.serial, name, heading, caption)

    def _draw_data(self, scene: LiveStudy) -> None:
        study = scene.study
        with ui.expansion("The data, and this as a command and in Python").classes("w-full"):
            if study.records:
                ui.html(panels.records_table(study.records), sanitize=False).classes(
                    "wide w-full"
                ).props("tabindex=0")
            frame.draw_local_plugins(self.session)
            ui.html("<p class='soft' style='margin:12px 0 4px'>The same from a terminal:</p>",
                    sanitize=False)  # fmt: skip
            frame.draw_code(frame.shell_command(study))
            text = python_text.program_text(study, self.session.out)
            if text:
                ui.html("<p class='soft' style='margin:12px 0 4px'>In Python:</p>", sanitize=False)
                frame.draw_code(text)

    def _draw_links(self, scene: LiveStudy) -> None:
        frame.draw_run_links(self.session, scene)
        studies.draw_study_menu(self.session, scene.study, ui.navigate.reload, lambda: None)

    # --- clicks ----------------------------------------------------------------------------------

    def _select_turn(self, to: int | None) -> None:
        turn = self.scene().study.turn
        if turn is not None and to is not None:
            self._run_or_notify(lambda: self.session.move(self.ident, to, turn.serial))

    def _cancel_order(self) -> None:
        self.session.cancel(self.ident)

    def _run_or_notify(self, what: Callable[[], None]) -> None:
        try:
            what()
        except SpiralError as error:
            frame.notify_error(error)
        self.refresh()


_NEVER = object()


def study_page(session: Session, ident: str, at: Address) -> None:
    """Build the page of one study as its address says: at a step, with a tab of its figures."""
    try:
        scene = session.scene(ident)
        here = scene.study.turn
        if here and at.turn is not None and not scene.busy and scene.study.turn_of(at.turn):
            session.move(ident, at.turn, here.serial)
    except SpiralError as error:
        frame.not_found_page(error)
        return
    view = StudyView(session, ident, at)
    with frame.header_bar(scene.study.title):
        view.regions["links"] = ui.row().classes("items-center gap-2")
    with frame.progress_bar():
        view.regions[WORKING] = ui.element("div").style("width:100%").props('role="status"')
    view.said = ui.label("").classes("unseen").props('role="status"')
    with ui.element("div").classes("wrap"):
        view.regions["tour"] = ui.element("div")
        view.regions["trouble"] = ui.element("div")
        with ui.element("div").classes("split").style("align-items:stretch"):
            view.regions["hero"] = ui.element("section").classes("card").style("height:100%")
            view.regions[FALLING] = ui.element("section").classes("card")
            view.regions[FALLING].style(f"min-height:{FALL_HEIGHT + 38}px")
        with ui.element("div").classes("split"):
            view.regions["missing"] = ui.element("section").classes("card")
            view.regions[FIGURES] = ui.element("section").classes("card")
        view.regions["beside"] = ui.element("section").classes("card")
        view.regions["data"] = ui.element("section").classes("card")
    watch_width(lambda: view.redraw(FALLING, "missing", FIGURES, "beside"))
    view.press.watch(view.refresh)
    view.refresh()
    ui.timer(_TICK, view.refresh)
