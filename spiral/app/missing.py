"""The list of candidates with their evidence and the button Add; an effect of the user's own."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from nicegui import ui

from spiral.app import frame, horizon_errors, panels
from spiral.app.narrow import is_narrow
from spiral.app.own_effect import normalize_effect_name
from spiral.app.session import LiveStudy, Session
from spiral.app.study import StudyState, trial_figure_file, turn_folder
from spiral.types.errors import SpiralError
from spiral.types.formatting import number
from spiral.types.label import name_of

_SHOWN = 5  # candidates before "show all"
_SHOWN_NARROW = 3  # where figures stand below them
_OWN = (
    ("name", "Name", "hardening"),
    ("formula", "Force on the machine", "-k3*q**3"),
    ("shape", "Gaps, widths, open units (SI)", "w=0.003, b=N/m"),
)
_WHY = (
    "Error of the free run on the test record, moment by moment: green where it helps, red where "
    "it costs. Dotted: the sensor's noise."
)
_FORCE = (
    "What the model lacks on the fitted record, with its 95 % band, and what this effect pushes "
    "with at the same states: alone (dotted), and with what its refit changes elsewhere. Below, "
    "the mean of each over the state that the missing force follows best."
)
_SHOWS = {
    "why": ("Where it helps", _WHY),
    "force": ("Its force over the missing one", _FORCE),
}
OWN = "invent"  # the order that an effect of one's own gives


@dataclass
class CandidateList:
    """The list of candidates in one tab: what is typed and how much of it is shown.

    ``ask`` runs what a click asks for and shows a refusal; ``again`` draws the list anew.
    ``every``: all candidates are shown; ``typed`` and ``wrong``: what is in the fields of an own
    effect, and the error in it; ``why``: the figures that are open; ``lengths``: what is typed in
    the field for lengths of tests, by those that were tried.
    """

    session: Session
    ident: str
    ask: Callable[[Callable[[], None]], None]
    again: Callable[[], None]
    every: bool = False
    typed: dict[str, str] = field(default_factory=dict)
    wrong: Mapping[str, str] | None = None
    why: set[tuple[int, str, str]] = field(default_factory=set)
    lengths: dict[str, str] = field(default_factory=dict)

    def build(self, scene: LiveStudy) -> None:
        """Draw the list of the turn that is looked at."""
        turn = scene.study.turn
        ui.html("<h2 class='head'>What is missing</h2>", sanitize=False)
        if turn is None or turn.candidates is None:
            waiting = scene.busy is not None
            if waiting and scene.scored:
                self._draw_preliminary(scene.scored)
                return
            said = "Ranking the effects that may be missing …" if waiting else "Not ranked yet."
            ui.html(f"<p class='soft'>{said}</p>", sanitize=False)
            if turn is not None and not waiting:
                ranked = functools.partial(self.session.rank, self.ident, turn.serial)
                asked = functools.partial(self.ask, ranked)
                ui.button("Rank what may be missing", on_click=asked).props("outline")
            return
        if turn.proposed:
            self._draw_proposal(scene, turn)
        else:
            self._draw_ending(scene, turn)
        ui.html(panels.caveats_note(turn.caveats), sanitize=False)
        for alike in turn.alike:
            self._draw_plan(scene, turn, tuple(alike))
        self._draw_candidates(scene, turn)
        self._draw_own_effect(scene, turn)

    def _draw_preliminary(self, scored: Sequence[Mapping[str, Any]]) -> None:
        """The best candidates as scored before any is refitted, which none can be added from."""
        ui.html(f"<div class='note' id='preliminary'>{panels.PRELIMINARY}</div>", sanitize=False)
        for candidate in scored[:_SHOWN]:
            with ui.element("div").classes("effect"):
                ui.html(panels.candidate_title(candidate), sanitize=False)
                shares = panels.candidate_evidence(candidate)
                ui.html(shares, sanitize=False).classes("evidence")

    def _draw_ending(self, scene: LiveStudy, turn: StudyState) -> None:
        """The message where no candidate is confirmed."""
        said = panels.ending_message(scene.study, turn)
        kind = "good" if turn.verdict == "whiteness" else "note"
        ui.html(f"<div class='{kind}' id='ending'>{said}</div>", sanitize=False)
        if panels.has_learnable_curve(scene.study, turn):
            learn = functools.partial(self.session.learn, self.ident, turn.serial)
            button = ui.button("Offer its curve as an effect", on_click=lambda: self.ask(learn))
            button.props("outline").style("margin:10px 0").set_enabled(scene.busy is None)

    def _draw_candidates(self, scene: LiveStudy, turn: StudyState) -> None:
        """The candidates, best first, and a button for the others."""
        if not turn.candidates:
            return
        few = self._least(turn)
        if self._listed(scene, turn):
            ui.html(f"<p class='soft order'>{panels.ranking_order_note(turn)}</p>", sanitize=False)
        rows = ui.element("div").classes("candidates")
        drawn: dict[str, ui.element] = {}
        left = len(turn.candidates) - few
        more = "more" if few else "candidate" + "s" * (left > 1)

        def said() -> str:
            return "Show fewer" if self.every else f"Show {left} {more}"

        def toggle() -> None:
            self.every = not self.every
            if not few:  # with the words above the list
                self.again()
                return
            self._list_candidates(scene, turn, rows, drawn)
            button.set_text(said())

        self._list_candidates(scene, turn, rows, drawn)
        if left > 0:
            button = ui.button(said(), on_click=toggle).props("flat dense")

    def _least(self, turn: StudyState) -> int:
        """How many candidates are shown before all are asked for."""
        if turn.verdict == "whiteness":
            return 0
        return _SHOWN_NARROW if is_narrow() else _SHOWN

    def _listed(self, scene: LiveStudy, turn: StudyState) -> list[Mapping[str, Any]]:
        """The candidates that are shown; those of the user and the proposed ones always."""
        candidates = list(turn.candidates or ())
        count = len(candidates) if self.every else self._least(turn)
        always = {*scene.study.own, *turn.proposed}
        return [c for i, c in enumerate(candidates)
                if i < count or {c["effect"], name_of(c["effect"])} & always]  # fmt: skip

    def _list_candidates(
        self, scene: LiveStudy, turn: StudyState, rows: ui.element, drawn: dict[str, ui.element]
    ) -> None:
        """Show the candidates in ``rows``; those in ``drawn`` stay, as one may be clicked now."""
        shown = {c["effect"]: c for c in self._listed(scene, turn)}
        for effect in drawn.keys() - shown.keys():
            drawn.pop(effect).delete()
        for place, (effect, candidate) in enumerate(shown.items()):
            if effect not in drawn:
                with rows:
                    drawn[effect] = self._draw_candidate(scene, turn, candidate)
                drawn[effect].move(target_index=place)

    def _draw_proposal(self, scene: LiveStudy, turn: StudyState) -> None:
        """What the trial of the proposed effect says; where there was none, a button for it."""
        said, kind = panels.proposal_message(turn)
        name = {"worse": "note worse", "fine": "good", "trying": "soft"}[kind]
        ui.html(f"<div class='{name}' id='proposal'>{said}</div>", sanitize=False)
        if kind == "trying" and scene.busy is None:
            attempt = functools.partial(self.session.preview, self.ident, turn.proposed[0])
            button = ui.button("Try it on the test record")
            button.on_click(lambda: self.ask(lambda: attempt(turn.serial))).props("outline")

    def _draw_own_effect(self, scene: LiveStudy, turn: StudyState) -> None:
        """An effect written as a formula, tested at once; what was typed stays when it is drawn."""
        typed, about = self.typed, scene.study.example
        failed = scene.study.trouble or {}
        wrong = self.wrong or (failed if typed and failed.get("at") == OWN else None)
        opened = bool(typed or wrong)
        with ui.expansion("Write an effect of your own", value=opened).classes("w-full own"):
            ui.html(panels.formula_help(about), sanitize=False)
            for key, label, said in _OWN:
                shown = about.get("formula", said) if key == "formula" else said
                box = ui.input(label, value=typed.get(key, ""), placeholder=shown)
                box.on_value_change(functools.partial(self._store_typed, key))
                box.props("outlined dense").classes("w-full").style("margin-top:8px")
                box.on("keydown.enter", lambda: self._test_own_effect(turn.serial))
            if wrong:
                with ui.element("div").classes("trouble").props('role="alert" id="own-trouble"'):
                    ui.html(panels.error_message(wrong), sanitize=False)
            button = ui.button("Test it", on_click=lambda: self._test_own_effect(turn.serial))
            button.props("outline").style("margin-top:10px").set_enabled(scene.busy is None)

    def _store_typed(self, key: str, event: Any) -> None:
        self.typed[key] = event.value or ""

    def _test_own_effect(self, serial: int) -> None:
        """Test what was typed; what is wrong with it stands beside the fields."""
        name, formula, shape = (self.typed.get(key, "") for key, _, _ in _OWN)
        self.wrong = None
        try:
            self.session.invent(self.ident, name, formula, serial, shape)
        except SpiralError as error:
            self.wrong = error.as_dict()
        self.again()

    def _draw_candidate(self, scene: LiveStudy, turn: StudyState, candidate: Any) -> ui.element:
        effect, aliases = candidate["effect"], tuple(candidate["aliases"])
        first = effect in turn.proposed
        with ui.element("div").classes("effect first" if first else "effect") as row:
            ui.html(panels.candidate_title(candidate), sanitize=False)
            add = ui.button("Add", on_click=lambda: self._add_effect(effect, turn.serial))
            filled = first and panels.proposal_message(turn)[1] == "fine"
            add.props("unelevated color=primary" if filled else "outline color=primary")
            add.props["aria-label"] = f"Add {panels.label_words(effect)}"
            add.set_enabled(scene.busy is None)
            ui.html(panels.candidate_evidence(candidate), sanitize=False).classes("evidence")
            self._draw_trial(scene, turn, effect)
            if effect in turn.rejected:
                ui.label(f"Refused: {turn.rejected[effect]}").classes("alike")
            if aliases:
                with ui.element("div").classes("alike"):
                    ui.html(panels.indistinguishable_note(aliases), sanitize=False)
                    self._draw_alias_comparison(scene, turn, (effect, *aliases))
                    self._draw_plan(scene, turn, (effect, *aliases))
        return row

    def _draw_trial(self, scene: LiveStudy, turn: StudyState, effect: str) -> None:
        """What an effect does on the test record, and where; a button where that is not known."""
        trial = panels.trial_result(turn, effect)
        if not trial:
            attempt = functools.partial(self.session.preview, self.ident, effect, turn.serial)
            button = ui.button("Try it on the test record", on_click=lambda: self.ask(attempt))
            button.props("flat dense").classes("try").set_enabled(scene.busy is None)
            button.props["aria-label"] = f"Try {panels.label_words(effect)} on the test record"
            return
        ui.html(horizon_errors.trial_changes(trial["changes"]), sanitize=False).classes(
            "wide"
        ).props("tabindex=0")
        ui.html(panels.sign_warnings(trial.get("signs") or {}), sanitize=False).classes(
            "wide"
        ).props("tabindex=0")
        for what, (title, said) in _SHOWS.items():
            if not trial.get("drawn" if what == "why" else "pushes"):
                continue
            key = (turn.serial, effect, what)
            with ui.expansion(title, value=key in self.why).classes("wide") as box:
                if key in self.why:
                    self._draw_trial_figure(
                        turn, effect, what, f"{title}: {panels.label_words(effect)}. {said}"
                    )
                    ui.html(f"<p class='soft'>{said}</p>", sanitize=False)
            box.on_value_change(functools.partial(self._toggle_figure, key))

    def _toggle_figure(self, key: tuple[int, str, str], event: Any) -> None:
        if bool(event.value) != (key in self.why):
            self.why ^= {key}
            self.again()

    def _draw_trial_figure(self, turn: StudyState, effect: str, what: str, said: str) -> None:
        """A figure of an effect's trial."""
        figures = turn_folder(self.session.out, self.ident, turn.serial) / "figures"
        data = frame.load_figure(trial_figure_file(figures, effect, what))
        if data is None:
            ui.html("<p class='soft'>This figure is not there any more.</p>", sanitize=False)
            return
        frame.draw_plot(data, what, said)

    def _draw_plan(self, scene: LiveStudy, turn: StudyState, effects: tuple[str, ...]) -> None:
        """The test to run next that tells effects apart; a button where none was asked for."""
        if scene.plan.get("effects") == list(effects):
            ui.html(panels.plan_table(scene.plan), sanitize=False).props('id="plan"')
            if scene.plan["tried"]:
                self._draw_longer_plan(scene, turn, effects)
            return
        wanted = functools.partial(self.session.plan, self.ident, effects, turn.serial)
        names = horizon_errors.join_words([panels.label_words(e) for e in effects])
        button = ui.button(f"Which test tells {names} apart?", on_click=lambda: self.ask(wanted))
        button.props("flat dense align=left").set_enabled(scene.busy is None)

    def _draw_longer_plan(
        self, scene: LiveStudy, turn: StudyState, effects: tuple[str, ...]
    ) -> None:
        """A field for other lengths of the tests, where none of those tried suffices."""
        tried = ", ".join(number(seconds) for seconds in scene.plan["tried"])
        with ui.row().classes("items-center no-wrap gap-2").style("margin:6px 0"):
            box = ui.input(
                "Lengths to try, s", placeholder=tried, value=self.lengths.get(tried, ""),
                on_change=lambda e: self.lengths.update({tried: e.value or ""}),
            )  # fmt: skip
            box.props("outlined dense").style("flex:1 1 auto")

            def plan_again() -> None:
                self.session.plan(self.ident, effects, turn.serial, box.value or "")

            box.on("keydown.enter", lambda: self.ask(plan_again))
            again = ui.button("Plan again", on_click=lambda: self.ask(plan_again))
            again.props("outline").classes("one-line").set_enabled(scene.busy is None)

    def _draw_alias_comparison(
        self, scene: LiveStudy, turn: StudyState, effects: tuple[str, ...]
    ) -> None:
        if scene.contrast:
            ui.html(panels.contrast_table(scene.contrast, scene.windows), sanitize=False)
            with ui.row().classes("gap-2").style("margin:8px 0 4px"):
                for effect in effects:
                    add = ui.button(f"Add {panels.label_words(effect)}")
                    add.on_click(functools.partial(self._add_effect, effect, turn.serial))
                    add.props("outline dense padding='2px 10px'").set_enabled(scene.busy is None)
            return
        compare = ui.button(
            "Compare them", on_click=lambda: self._contrast_effects(effects, turn.serial)
        )
        compare.props("flat dense").set_enabled(scene.busy is None)

    def _add_effect(self, effect: str, serial: int) -> None:
        self.every = False
        if name_of(effect) == normalize_effect_name(self.typed.get("name", "")):
            self.typed.clear()  # it is in the model now
        self.ask(lambda: self.session.add(self.ident, effect, serial))

    def _contrast_effects(self, effects: tuple[str, ...], serial: int) -> None:
        self.ask(lambda: self.session.contrast(self.ident, effects, serial))
