"""A system written as data: equations as text, units, what is measured, where forces may act.

equations: ["m*x'' + c*x' + k*x = F"]
states: {x: m}
inputs: {F: N}
parameters: {m: 2.0 kg, c: N*s/m, k: 400 N/m}
free: [k]
observed: [x]
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import Any, get_args

from spiral.physics.formulas.let import is_reserved, let_formulas, write_out
from spiral.physics.formulas.observed import split_observed
from spiral.types.errors import (
    ConfigError,
    InputError,
    PluginError,
    did_you_mean,
    similar_files,
)
from spiral.types.fields import unknown_field
from spiral.types.parameter import Input, Interpolation, Parameter, State
from spiral.types.units import short_form

ENDINGS = (".yaml", ".yml", ".toml", ".json")
LARGEST = 1_000_000  # bytes of a file

_NAME = re.compile(r"[A-Za-z_]\w*")


@dataclass(frozen=True)
class SystemDefinition:
    """What a file or a call says of a system.

    Fields
    ------
    equations : one for each state, ``LEFT = RIGHT``; ``x'`` and ``x''`` are rates, of an input the
        first alone (also ``z_rate``).
    states : name -> unit, or ``{unit: V, like: NAME of a measured state of alike values}``,
        or ``{unit: K, start: 293}``, where a hidden one begins.
    inputs : name -> unit, or ``{unit: N, interpolation: zero_order}``.
    parameters : name -> ``VALUE UNIT``, ``[VALUE, UNIT]``, ``UNIT`` where it is to be found, or
        ``{value: 2.0, unit: kg, lower: 0, upper: 5}``.
    constants : name -> ``VALUE UNIT``: numbers of the equations that have a unit.
    free : parameters with a value that the fit moves all the same.
    observed : states that are measured, rates ``x'``, accelerations ``x''`` and formulas
        ``load = k*(x - z)``; states that are not named are hidden.
    ports : name -> position as a formula of the states, or a list with one for each axis; left
        out, one for each coordinate.
    mass : coordinate -> its inertia, or a list of rows, where the equations are solved for the
        accelerations and forces on one coordinate move others too.
    title : what the system is, in a few words.
    named : name -> formula of parts of equations, of the section ``let``.
    converted : name -> what its owner wrote, of what is in SI here (``physics.formulas.coherent``).
    """

    equations: tuple[str, ...]
    states: tuple[State, ...]
    inputs: tuple[Input, ...]
    parameters: tuple[Parameter, ...]
    constants: tuple[tuple[str, float, str], ...]
    values: tuple[tuple[str, float], ...]
    observed: tuple[str, ...]
    readings: tuple[tuple[str, str], ...]
    ports: tuple[tuple[str, tuple[str, ...]], ...]
    mass: tuple[tuple[str, ...], ...] | tuple[tuple[str, str], ...]
    title: str = ""
    named: tuple[tuple[str, str], ...] = ()
    converted: tuple[tuple[str, str], ...] = ()

    @property
    def units(self) -> dict[str, str]:
        """Name -> unit of all that equations may name, rates and the time apart."""
        rates = (i.rate for i in self.inputs if i.derivative)
        named = (*self.states, *self.inputs, *rates, *self.parameters)
        return {**{i.name: i.unit for i in named}, **{n: u for n, _, u in self.constants}}


_DERIVED = ("values", "readings", "named")  # fields that follow from other sections
SECTIONS = (*(f.name for f in fields(SystemDefinition) if f.name not in _DERIVED), "free", "let")


def check_free_parameters(definition: SystemDefinition) -> None:
    """Raise ConfigError for a free parameter that is in no formula: no record tells its value.

    Not for equations around a program, which its parameters go into.
    """
    texts = [
        *definition.equations,
        *(text for _, text in definition.readings),
        *(text for _, axes in definition.ports for text in axes),
        *(text for row in definition.mass for text in row),
    ]
    used = {*_NAME.findall(" ".join(texts))}
    for name in (p.name for p in definition.parameters if p.start is None):
        if name not in used:
            raise ConfigError(
                f"free: {name}, which is in no equation", "a parameter that an equation holds",
                f"{name} in an equation or a reading, or no {name} in free",
            )  # fmt: skip


@lru_cache(maxsize=64)
def definition_of(text: str) -> SystemDefinition:
    """A definition from its text, the formulas that its section ``let`` names written out.

    Raises
    ------
    ConfigError : a section, a unit or a value that cannot be used.
    """
    given = parse_sections(text)
    for name in given:
        if name not in SECTIONS:
            raise unknown_field("system", str(name), SECTIONS)
    named, given = let_formulas(given), write_out(given)
    free = tuple(map(str, given.get("free") or ()))
    constants = tuple(
        (n, *_required_quantity(n, v)) for n, v in _section(given, "constants").items()
    )
    equations = _text_list(given, "equations")
    states = _section(given, "states", needed=True)
    twice = [n for n in states if any(f"{n}''" in e for e in equations)]
    observed, readings = split_observed(_text_list(given, "observed"), twice)
    definition = SystemDefinition(
        equations=equations,
        states=tuple(_state(n, v) for n, v in states.items()),
        inputs=tuple(_input(n, v) for n, v in _section(given, "inputs").items()),
        parameters=tuple(
            _parameter(n, v, n in free) for n, v in _section(given, "parameters").items()
        ),
        constants=constants,
        values=tuple(
            (n, value)
            for n, v in _section(given, "parameters").items()
            if n in free and (value := _quantity(n, v)[0]) is not None
        ),
        observed=observed,
        readings=readings,
        ports=_port_formulas(_section(given, "ports")),
        mass=_mass_entries(given.get("mass")),
        title=str(given.get("title") or ""),
        named=tuple(named.items()),
        converted=tuple((n, str(v)) for n, v in _section(given, "converted").items()),
    )
    _check_declared_names(definition, free, [f"{name}_rate" for name in twice])
    return _with_input_rates(definition)


def _with_input_rates(definition: SystemDefinition) -> SystemDefinition:
    """Mark the inputs whose rate ``z'`` or ``z_rate`` the equations use."""

    def is_rate_used(item: Input) -> bool:
        rate = item.rate.name
        either = re.compile(rf"\b{item.name}'|\b{rate}\b")
        texts = (*definition.equations, *(text for _, text in definition.readings))
        return rate not in definition.units and any(map(either.search, texts))

    return replace(
        definition, inputs=tuple(replace(i, derivative=is_rate_used(i)) for i in definition.inputs)
    )


def text_of_file(path: str | Path) -> str:
    """The text of a definition in a file.

    Raises
    ------
    InputError : a file that cannot be read, or of another kind.
    """
    place = Path(path).expanduser()
    if place.suffix.lower() not in ENDINGS:
        raise InputError(f"system file {str(path)!r}", f"a file that ends in {', '.join(ENDINGS)}")
    try:
        if place.stat().st_size > LARGEST:
            raise InputError(f"{path}, {place.stat().st_size} bytes", f"at most {LARGEST}")
        text = place.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        said = error.strerror if isinstance(error, OSError) else error
        raise InputError(
            f"system file {str(path)!r}: {said}", "a file that can be read",
            similar_files(place) or "check the path",
        ) from error  # fmt: skip
    if place.suffix.lower() != ".toml":
        return text
    import tomllib

    try:
        return json.dumps(tomllib.loads(text), indent=1)
    except (tomllib.TOMLDecodeError, TypeError) as error:
        raise InputError(f"{path}: {error}", "TOML", "for instance states = {x = 'm'}") from error


def parse_sections(text: str) -> dict[str, Any]:
    """The sections of a text in YAML, of which JSON is a part.

    Raises
    ------
    ConfigError : no mapping of sections; the line is named.
    """
    import yaml

    try:
        sections = yaml.load(text, Loader=_unique_keys_loader())
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f", line {mark.line + 1}" if mark else ""
        reason = getattr(error, "problem", None) or type(error).__name__
        raise ConfigError(
            f"equations of a system{place}: {reason}", "YAML", "quotes around a text with : or #"
        ) from error
    if not isinstance(sections, dict):
        raise ConfigError("equations of a system without sections", f"{', '.join(SECTIONS)}",
                          "equations: [\"m*x'' + k*x = F\"]")  # fmt: skip
    return sections


@lru_cache(maxsize=1)
def _unique_keys_loader() -> Any:
    """YAML's safe loader, to which a key that stands twice is an error, as YAML 1.2 has it."""
    import yaml

    class UniqueKeys(yaml.SafeLoader):
        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
            seen: set[str] = set()
            for key, _ in node.value:
                if isinstance(key, yaml.ScalarNode):
                    if key.value in seen:
                        line = key.start_mark.line + 1
                        raise ConfigError(
                            f"equations of a system, line {line}: a second {key.value!r}",
                            "each name once",
                        )
                    seen.add(key.value)
            return super().construct_mapping(node, deep)

    return UniqueKeys


def value_and_unit(name: str, given: Any) -> tuple[float | None, str]:
    """``2.0 kg``, ``[2.0, kg]``, ``2.0`` or ``kg`` -> value (none where only a unit) and unit."""
    if isinstance(given, str):
        first, _, rest = given.strip().partition(" ")
        value = _float_or_none(first)
        if value is None:
            return None, given.strip()
        return _require_number(name, value), rest.strip()
    if isinstance(given, int | float) and not isinstance(given, bool):
        return _require_number(name, given), ""
    if isinstance(given, list | tuple) and len(given) == 2:
        return _require_number(name, given[0]), str(given[1] or "")
    expected = "a value and a unit; uncertainties of known parameters are not used"
    raise ConfigError(f"{name}: {given!r}", expected, f"{name}: 2.0 kg")


def _float_or_none(text: Any) -> float | None:
    try:
        return None if isinstance(text, bool) else float(text)
    except (TypeError, ValueError):
        return None


def _require_number(name: str, given: Any) -> float:
    value = _float_or_none(given)
    if value is None or not isfinite(value):
        raise ConfigError(f"{name}: {given!r}", "a finite number", f"{name}: 2.0 kg")
    return value


# --- sections ------------------------------------------------------------------------------------


def _section(given: Mapping[str, Any], name: str, needed: bool = False) -> dict[str, Any]:
    section = given.get(name)
    if (section is None or section == []) and not needed:
        return {}
    if not isinstance(section, Mapping) or (needed and not section):
        raise ConfigError(f"{name}: {section!r}", "a mapping NAME: UNIT", f"{name}: {{x: m}}")
    return {str(k): v for k, v in section.items()}


def _text_list(given: Mapping[str, Any], name: str) -> tuple[str, ...]:
    entries = given.get(name)
    entries = [entries] if isinstance(entries, str) else entries
    if not isinstance(entries, list | tuple) or not entries:
        raise ConfigError(f"{name}: {entries!r}", "a list with at least one", f"{name}: [...]")
    texts: list[str] = []
    for one in entries:  # ``load: k*x`` in YAML is as good as "load = k*x"
        pairs = one.items() if isinstance(one, Mapping) else ()
        texts += [f"{k} = {v}" for k, v in pairs] or [str(one)]
    return tuple(texts)


def _entry_fields(section: str, name: str, given: Any, known: tuple[str, ...]) -> dict[str, Any]:
    """The fields of an entry that is a mapping; a text alone is its unit."""
    if not isinstance(given, Mapping):
        return {"unit": "" if given is None else str(given)}
    for key in given:
        if key not in known:
            raise unknown_field(f"{section}.{name}", str(key), known)
    return {"unit": "", **given}


def _valid_unit(name: str, unit: Any) -> str:
    text = str(unit or "").strip()
    text = "" if text == "1" else text
    try:
        short_form(text)
    except Exception as error:  # pint's parser raises what Python's tokenizer does
        unknown = " and ".join(getattr(error, "unit_names", ()))  # of pint's UndefinedUnitError
        about = f": no {unknown} is known" if unknown else ""
        raise ConfigError(
            f"unit {text!r} of {name}{about}", "a unit such as 'm', 'N*s/m', 'rad/s', 'V'"
        ) from error
    return text


def _state(name: str, given: Any) -> State:
    entry = _entry_fields("states", name, given, ("unit", "like", "start"))
    start = _float_or_none(entry.get("start", 0.0))
    if start is None or not isfinite(start):
        raise ConfigError(
            f"start of {name}: {entry['start']!r}", "a number in the state's unit",
            f"{name}: {{unit: K, start: 293}}",
        )  # fmt: skip
    return _build_declaration(
        State,
        name,
        _valid_unit(name, entry["unit"]),
        like=str(entry.get("like") or ""),
        start=start,
    )


def _input(name: str, given: Any) -> Input:
    entry = _entry_fields("inputs", name, given, ("unit", "interpolation"))
    kind = entry.get("interpolation", "smooth")
    if kind not in get_args(Interpolation):
        known = get_args(Interpolation)
        raise ConfigError(
            f"interpolation {kind!r} of input {name}",
            f"one of {', '.join(known)}",
            did_you_mean(str(kind), known),
        )
    return _build_declaration(Input, name, _valid_unit(name, entry["unit"]), interpolation=kind)


def _quantity(name: str, given: Any) -> tuple[float | None, str]:
    if isinstance(given, Mapping):
        value = given.get("value")
        return (None if value is None else _require_number(name, value)), str(
            given.get("unit") or ""
        )
    return value_and_unit(name, given)


def _required_quantity(name: str, given: Any) -> tuple[float, str]:
    value, unit = _quantity(name, given)
    return _require_number(name, value), _valid_unit(name, unit)


def _parameter(name: str, given: Any, free: bool) -> Parameter:
    if isinstance(given, Mapping):
        _entry_fields("parameters", name, given, ("value", "unit", "lower", "upper"))
    value, unit = _quantity(name, given)
    bounds = given if isinstance(given, Mapping) else {}
    low, high = (
        None if bounds.get(k) is None else _require_number(name, bounds[k])
        for k in ("lower", "upper")
    )
    if value is not None and not (
        (low is None or low <= value) and (high is None or value <= high)
    ):
        raise ConfigError(
            f"parameter {name!r} of {value:g} {unit}".rstrip(),
            f"a value within its bounds, lower {low} and upper {high}",
            "correct the value or the bound",
        )
    unbounded = not {"lower", "upper"} & set(bounds)
    if free and value and unbounded:  # it keeps the sign that it was given
        low, high = (0.0, None) if value > 0 else (None, 0.0)
    start = None if free else value
    return _build_declaration(
        Parameter, name, _valid_unit(name, unit), lower=low, upper=high, start=start
    )


def _build_declaration(kind: Any, name: str, unit: str, **options: Any) -> Any:
    try:
        return kind(name, unit, **options)
    except PluginError as error:
        raise ConfigError(error.given, error.expected, error.try_) from error


def _port_formulas(given: Mapping[str, Any]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return tuple(
        (n, tuple(map(str, v)) if isinstance(v, list | tuple) else (str(v),))
        for n, v in given.items()
    )


def _mass_entries(given: Any) -> Any:
    if not given:
        return ()
    if isinstance(given, Mapping):
        return tuple((str(k), str(v)) for k, v in given.items())
    rows = [r if isinstance(r, list | tuple) else [r] for r in given]
    return tuple(tuple(map(str, r)) for r in rows)


def _check_declared_names(
    definition: SystemDefinition, free: tuple[str, ...], rates: list[str]
) -> None:
    named = [i.name for i in (*definition.states, *definition.inputs, *definition.parameters)]
    named += [n for n, _, _ in definition.constants] + [n for n, _ in definition.readings]
    for name in named:
        if named.count(name) > 1 or is_reserved(name):
            what = "twice" if named.count(name) > 1 else "for a state, an input or a parameter"
            raise ConfigError(f"the name {name!r} {what}", "a name of its own", f"{name}_1")
    own = (n for n, _ in definition.readings)
    _require_known(
        "observed", definition.observed, [*(s.name for s in definition.states), *rates, *own]
    )
    _require_known("free", free, [p.name for p in definition.parameters])
    _require_known("like", [s.like for s in definition.states if s.like], list(definition.observed))


def _require_known(what: str, given: Iterable[str], known: list[str]) -> None:
    for name in given:
        if name not in known:
            raise ConfigError(
                f"{what}: {name}", f"one of {', '.join(known) or 'none'}", did_you_mean(name, known)
            )
