"""How functions are compiled that are only ever compiled into others.

numba makes machine code of every function that it meets, also of one that nothing calls from
Python, and at each level it optimises again all that lies below. Here such a function is only
prepared for being linked: the entry point that contains it is optimised once, as a whole. The
machine code of a bench is then ready in about half of the time, with the same numbers.

This uses parts of numba that it does not document, as they are in the versions of `KNOWN`. With any
other version functions are compiled in numba's ordinary way.
"""

from __future__ import annotations

from typing import Any

import numba
from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import LoweringPass, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import AnnotateTypes, NativeLowering

KNOWN = ("0.68",)
"""Versions of numba that this was tried with, as beginnings of their numbers."""


class _InnerLibrary(JITCodeLibrary):  # type: ignore[misc, unused-ignore]
    """Code that waits for being linked into that of a caller."""

    def _optimize_final_module(self) -> None:
        """Inline what is always inlined; the rest is for the entry point."""
        passes, builder = self._codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=0, cost="cheap"
        )
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        """Make no machine code."""
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


@register_pass(mutates_CFG=False, analysis_only=False)
class _Begin(LoweringPass):  # type: ignore[misc, unused-ignore]
    """Before the code is written: choose where it goes."""

    _name = "inner_begin"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        state.library = _InnerLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        return True


@register_pass(mutates_CFG=False, analysis_only=False)
class _End(LoweringPass):  # type: ignore[misc, unused-ignore]
    """Afterwards: make the function known to its callers."""

    _name = "inner_end"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        made, library = state["cr"], state.library
        about = made.fndesc
        # A name for the code; `_Inner` sees to it that nobody calls it.
        name = _dynfunc.make_function(
            about.lookup_module(), about.qualname.split(".")[-1], "", 0, made.env, (library,)
        )
        state.targetctx.insert_user_function(name, about, [library])
        state.reload_init.extend(library._reload_init)
        state["cr"] = made._replace(cfunc=name)
        return True


class _InnerCompiler(CompilerBase):  # type: ignore[misc, unused-ignore]
    """numba's passes, with another library for the code."""

    def define_pipelines(self) -> list[Any]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_Begin, AnnotateTypes)
        passes.add_pass_after(_End, NativeLowering)
        passes.finalize()
        return [passes]


class _Inner(CPUDispatcher):  # type: ignore[misc, unused-ignore]
    """A function that Python cannot call: there is no machine code of it."""

    def __call__(self, *args: Any, **named: Any) -> Any:
        """Refuse.

        Raises:
            TypeError: always.
        """
        raise TypeError(
            f"{self.py_func.__qualname__} is only compiled into other functions; in Python, call"
            " its py_func"
        )


def inner(function: Any, **options: Any) -> Any:
    """Compile a function for others to call, or to be inlined into with ``forceinline``."""
    if not numba.__version__.startswith(KNOWN):
        return numba.njit(**options)(function)
    made = numba.njit(pipeline_class=_InnerCompiler, no_cpython_wrapper=True, **options)(function)
    made.__class__ = _Inner
    return made
