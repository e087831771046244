"""Declarations of a dataclass's fields: rules, for values in Python and in files, and meanings.

A dataclass whose fields carry rules is a section of a file as it stands: `Section` reads it, pydantic walks through it.
`Variant` chooses one of several by the key `type`. Pydantic is imported when a file is read, not before.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, make_dataclass
from functools import cache
from inspect import cleandoc, getdoc, getsource
from itertools import pairwise
from textwrap import dedent
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_type_hints

from leanboom.errors import InputError
from leanboom.quantities.ranges import Range, Refused, Rule
from leanboom.quantities.rules import suggestion
from leanboom.quantities.units import Kind, expected

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter
    from pydantic_core import CoreSchema, InitErrorDetails


@dataclass(frozen=True, slots=True)
class Field:
    """One field: its rule, whether it must be given, and what it is if not."""

    rule: Rule
    required: bool
    default: Any


@cache
def declared(kind: type) -> dict[str, Field]:
    """The fields of a dataclass that carry a rule, by name."""
    hints = get_type_hints(kind, include_extras=True)
    found = {}
    for each in fields(kind):
        rule = _rule(hints[each.name])
        if rule is not None:
            found[each.name] = Field(rule, each.default is MISSING, each.default)
    return found


def _rule(hint: Any) -> Rule | None:
    """The rule in a type, also in an optional one."""
    parts = (hint, *get_args(hint)[:1])
    return next((part for each in parts for part in getattr(each, "__metadata__", ()) if isinstance(part, Rule)), None)


@cache
def meanings(kind: type) -> dict[str, str]:
    """Meanings of the fields of a dataclass, by name: the text below each in its source."""
    prefix, parts = getattr(kind, "prefix", ""), getattr(kind, "made_of", ())
    found = {name.removeprefix(prefix): text for part in parts for name, text in meanings(part).items()}
    return found | _texts(kind)


def _texts(kind: type) -> dict[str, str]:
    """The texts below the fields of a dataclass in its source."""
    try:
        body = ast.parse(dedent(getsource(kind))).body[0]
    except (OSError, TypeError):  # typed at a prompt, or made of others
        return {}
    assert isinstance(body, ast.ClassDef)
    return {
        named.target.id: cleandoc(text.value.value)
        for named, text in pairwise(body.body)
        if isinstance(named, ast.AnnAssign) and isinstance(named.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and isinstance(text.value.value, str)
    }


def derived(
    name: str,
    *parts: type,
    without: tuple[str, ...] = (),
    optional: tuple[str, ...] = (),
    empty: tuple[str, ...] = (),
) -> Any:
    """A dataclass with the fields of others.

    Args:
        name: Its name.
        *parts: The others; the last one gives its docstring.
        without: Fields that are left out.
        optional: Fields that are None if not given.
        empty: Those of them that a file may also give without a value.
    """
    kept = []
    for part in parts:
        hints = get_type_hints(part, include_extras=True)
        for each in fields(part):
            if each.name not in without:
                kind = hints[each.name] | None if each.name in empty else hints[each.name]
                default = None if each.name in optional else each.default
                kept.append((each.name, kind, field(default=default)))
    shared = {"made_of": parts, "__doc__": parts[-1].__doc__}
    return make_dataclass(name, kept, namespace=shared, frozen=True, slots=True, kw_only=True)


def file_of(part: type, prefix: str = "") -> Callable[[type], Any]:
    """A decorator: a dataclass of keys, of which those of type `Any` are fields of another as they are declared there.

    Args:
        part: The other dataclass.
        prefix: What the names of its fields have before the key.
    """

    def made(keys: type) -> Any:
        hints = get_type_hints(part, include_extras=True)
        for name, hint in keys.__annotations__.items():
            if hint == "Any":
                keys.__annotations__[name] = hints[prefix + name]
        keys.made_of, keys.prefix = (part,), prefix  # type: ignore[attr-defined]
        return dataclass(frozen=True, slots=True, kw_only=True)(keys)

    return made


def hold_declared(instance: Any, key: str) -> None:
    """Check the fields of a new frozen instance by their rules and keep them as floats and tuples.

    Args:
        instance: The instance.
        key: What messages call it; empty for nothing.

    Raises:
        InputError: A field is not allowed.
    """
    for name, one in declared(type(instance)).items():
        value = getattr(instance, name)
        if value is not one.default:
            object.__setattr__(instance, name, one.rule.kept(f"{key}.{name}" if key else name, value))


@dataclass(frozen=True, slots=True)
class Section(Rule):
    """A mapping in a file: its keys are the fields of a dataclass and no others."""

    made: type
    tag: str = ""  # its key `type`, which its reader has taken out; empty if it has none
    stated: bool = False  # whether keys with a default in Python must be given, too

    @property
    def fields(self) -> dict[str, Field]:
        """The fields of the section, without `type`."""
        found = declared(self.made)
        return {name: Field(each.rule, True, None) for name, each in found.items()} if self.stated else found

    @property
    def names(self) -> tuple[str, ...]:
        """The keys of the section."""
        return (*(("type",) if self.tag else ()), *self.fields)

    @property
    def allowed(self) -> str:
        """A mapping with these keys."""
        return f"must be a mapping with the keys {', '.join(self.names)}"

    def section_of(self, value: Any) -> Section:
        """The section itself."""
        return self

    def data(self, made: Any) -> dict[str, Any]:
        """A file's data for an instance, in SI units."""
        parts = {name: (field.rule, getattr(made, name)) for name, field in declared(self.made).items()}
        inner = {name: (rule.section_of(value), value) for name, (rule, value) in parts.items()}
        tag = {"type": self.tag} if self.tag else {}
        return tag | {name: value if part is None else part.data(value) for name, (part, value) in inner.items()}

    def load(self, data: Any) -> Any:
        """The instance that a file's data make.

        Raises:
            pydantic.ValidationError: With a line for each key that is wrong, its context `allowed` and `key`.
        """
        return _adapter(self).validate_python(data)

    def json_schema(self) -> dict[str, Any]:
        """The JSON schema of the section."""
        return _adapter(self).json_schema()

    def validated(self, value: Any, parts: Callable[[Any], Any]) -> Any:
        """The instance, or all errors of its keys, in their order."""
        from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError

        def line(
            allowed: str, loc: tuple[Any, ...], found: Any, kind: Any = "refused", key: str = ""
        ) -> InitErrorDetails:
            error = PydanticCustomError(kind, "{allowed}", {"allowed": allowed, "key": key})
            return InitErrorDetails(type=error, loc=loc, input=found)

        if not isinstance(value, dict):
            raise PydanticCustomError("refused", "{allowed}", {"allowed": self.allowed, "key": ""})
        known = self.fields
        lines = [line(suggestion(str(n), self.names), (n,), value[n], "unknown") for n in value if n not in known]
        lines += [
            line(f.rule.allowed, (n,), value, "missing") for n, f in known.items() if f.required and n not in value
        ]
        made = None
        try:
            made = parts({name: value[name] for name in value if name in known})
        except ValidationError as error:
            for found in error.errors(include_url=False):
                context = found.get("ctx", {})
                if "allowed" in context:
                    lines.append(line(context["allowed"], found["loc"], found["input"], found["type"], context["key"]))
                elif found["type"] != "missing":
                    lines.append(line(f"is refused: {found['msg']}", found["loc"], found["input"]))
        except InputError as error:  # its values do not fit together
            lines += [line(each.allowed, (each.key.rpartition(".")[2],), None, "counted") for each in error.problems]
            lines = lines or [line(str(error), (), value)]
        if lines:
            places = {name: i for i, name in enumerate(known)}
            lines.sort(key=lambda each: places.get(each["loc"][0], len(places)) if each.get("loc") else -1)  # type: ignore
            raise ValidationError.from_exception_data(self.made.__name__, lines)
        return made

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check around the dataclass."""
        from pydantic_core import core_schema

        return core_schema.no_info_wrap_validator_function(self.validated, handler(self.made))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """The keys as they are written, with their meanings."""
        reference = handler(schema)
        found = handler.resolve_ref_schema(reference)
        found["description"] = (getdoc(self.made) or "").split("\n")[0]
        found["additionalProperties"] = False
        for name, meaning in meanings(self.made).items():
            if name in found["properties"]:
                found["properties"][name]["description"] = meaning
        if self.tag:
            found["properties"] = {"type": {"const": self.tag}, **found["properties"]}
        required = [name for name in self.names if name not in self.fields or self.fields[name].required]
        for name in required:
            found["properties"][name].pop("default", None)
        if required:
            found["required"] = required
        return reference


@cache
def _adapter(section: Section) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(Annotated[Any, section])


class _Chosen(Rule):
    """A section that its reader chooses: pydantic is told of no type."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The value as the check returns it."""
        from pydantic_core import core_schema

        return core_schema.no_info_wrap_validator_function(self.validated, core_schema.any_schema())

    def _references(self, sections: Iterable[Section], handler: GetJsonSchemaHandler) -> list[dict[str, Any]]:
        return [section.__get_pydantic_json_schema__(_adapter(section).core_schema, handler) for section in sections]


class Variant(_Chosen):
    """A section that is one of several, told apart by its key `type`."""

    def __init__(self, kinds: Mapping[str, type]):
        self.kinds = kinds  # dataclasses by their type; may grow

    @property
    def choices(self) -> tuple[str, ...]:
        """The types of the variants."""
        return tuple(self.kinds)

    @property
    def sections(self) -> tuple[Section, ...]:
        """The sections by their types."""
        return tuple(Section(kind, name) for name, kind in self.kinds.items())

    @property
    def allowed(self) -> str:
        """A mapping of a known type."""
        return f"must be a mapping with the key type: {', '.join(self.choices)}"

    def check(self, value: Any) -> Any:
        """The instance, of a known type."""
        if not isinstance(value, dict):
            raise Refused(self.allowed)
        if "type" not in value:
            raise Refused(f"must be {', '.join(self.choices)}", "type", "missing")
        if value["type"] not in self.choices:
            raise Refused(f"must be {suggestion(str(value['type']), self.choices)}", "type")
        given = {name: part for name, part in value.items() if name != "type"}
        return Section(self.kinds[value["type"]], value["type"]).load(given)

    def section_of(self, value: Any) -> Section:
        """The section that an instance is written as.

        Raises:
            InputError: Its type has no name.
        """
        for section in self.sections:
            if section.made is type(value):
                return section
        raise InputError(f"type = {type(value).__name__}; must be one of {', '.join(self.choices)}")

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """One of the sections."""
        return {"oneOf": self._references(self.sections, handler)}


class OrSection(_Chosen):
    """A quantity, or a section in its place."""

    def __init__(self, quantity: Range, section: Section):
        self.quantity, self.section = quantity, section

    @property
    def kind(self) -> Kind:
        """What the quantity measures."""
        return self.quantity.kind

    @property
    def _mapping(self) -> str:
        return f"or {self.section.allowed.removeprefix('must be ')}"

    @property
    def allowed(self) -> str:
        """The quantity, or the mapping."""
        return f"{self.quantity.allowed}, {self._mapping}"

    def check(self, value: Any) -> Any:
        """The section's instance, or the quantity in SI units."""
        if isinstance(value, list):
            raise Refused(f"{expected('', self.kind)}, {self._mapping}")
        return self.section.load(value) if isinstance(value, dict) else self.quantity.check(value)

    def kept(self, key: str, value: Any) -> Any:
        """The section's instance, or the quantity in SI units."""
        return value if self.section_of(value) else self.quantity.kept(key, value)

    def section_of(self, value: Any) -> Section | None:
        """The section, if the value is an instance of its dataclass."""
        return self.section if isinstance(value, self.section.made) else None

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """One of the two."""
        return {"anyOf": [self.quantity.described({}), *self._references([self.section], handler)]}
