"""Verbs of ``roadsight``: typed functions, whose parameters make their command lines."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from roadsight.base.options import add_options, called


@dataclass(frozen=True)
class Verb:
    """A verb of the command line.

    Parameters
    ----------
    about : what it does, one line. run : does it; its parameters are the options.
    """

    name: str
    about: str
    run: Callable[..., None]

    def add_to(self, verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
        """Add it to the verbs of a command line."""
        parser = verbs.add_parser(self.name, help=self.about)
        add_options(parser, self.run, may_lack=False)
        parser.set_defaults(run=partial(called, self.run))
