"""Registries of items by name: built in, from entry points of installed packages, and added by a program."""

from __future__ import annotations

import pkgutil
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from leanboom.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Item = TypeVar("Item")

_NAME = re.compile(r"\w[\w.-]*")


@dataclass(frozen=True, slots=True)
class Registry(Generic[Item]):
    """Items of one kind by their names.

    Own items come before added ones, those before what installed packages bring.
    """

    kind: str  # what messages call an item, such as "method"
    group: str  # entry points that installed packages bring items by
    own: Mapping[str, Item | str]  # a text, "module:name", is imported when it is used
    fits: Callable[[Any], bool]  # whether an object can be an item
    what: str  # an item must be, in words
    added: dict[str, Item] = field(default_factory=dict)

    def names(self) -> tuple[str, ...]:
        """All names, in the order in which they are listed."""
        return tuple(dict.fromkeys((*self.own, *self.added, *(entry.name for entry in self._installed()))))

    def find(self, name: str) -> Item:
        """The item of a name.

        Raises:
            InputError: If there is none, or the package that brings it cannot be used.
        """
        item = self.own.get(name, self.added.get(name))
        if isinstance(item, str):
            return pkgutil.resolve_name(item)
        return self._load(name) if item is None else item

    def add(self, name: str, item: Item) -> None:
        """Add an item for as long as this process runs, or put it in the place of one added before.

        Args:
            name: Its name.
            item: The item.

        Raises:
            InputError: If the name is one of this package's own or no plain word, or the item does not fit.
        """
        if name in self.own:
            raise InputError(f"{self.kind} = {name}; is a name of leanboom's own, choose another")
        if not _NAME.fullmatch(name):
            raise InputError(f"{self.kind} = {name}; must be of letters, digits, '.', '_' and '-'")
        self.added[name] = self._checked(name, item)

    def _installed(self) -> Iterable[EntryPoint]:
        from importlib.metadata import entry_points  # takes a while

        return [entry for entry in entry_points(group=self.group) if _NAME.fullmatch(entry.name)]

    def _load(self, name: str) -> Item:
        found = next((entry for entry in self._installed() if entry.name == name), None)
        if found is None:
            raise InputError(f"{self.kind} = {name or 'nothing'}; must be one of {', '.join(self.names())}")
        package = "an installed package" if found.dist is None else f"package {found.dist.name}"
        try:
            item = found.load()
        except Exception as error:  # whatever another package does wrong
            text = f"{self.kind} = {name}; {package} brings it and cannot be imported: {type(error).__name__}: {error}"
            raise InputError(text) from error
        return self._checked(name, item)

    def _checked(self, name: str, item: Any) -> Item:
        if not self.fits(item):
            raise InputError(f"{self.kind} = {name}; is {type(item).__name__}, must be {self.what}")
        return item
