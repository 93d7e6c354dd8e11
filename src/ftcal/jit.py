"""LLVM IR text → machine code of this processor, through llvmlite.

Used by the wrench kernel and the smoothing filter. Where llvmlite cannot be had, `available()` is
False and the callers run the same source on NumPy. Calls go through ctypes and release the GIL.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
from dataclasses import dataclass
from typing import Any


@functools.cache
def available() -> bool:
    """Return whether llvmlite is installed on this machine."""
    return importlib.util.find_spec("llvmlite") is not None


@functools.cache
def vector_width() -> int:
    """Return how many float64 one vector register of this processor holds (2, 4 or 8)."""
    from llvmlite import binding as llvm

    features = llvm.get_host_cpu_features()
    return 8 if features.get("avx512f") else 4 if features.get("avx2") else 2


@functools.cache
def _initialise() -> None:
    from llvmlite import binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


@dataclass(frozen=True, slots=True)
class Module:
    """Compiled IR; keeps the engine alive for as long as its functions are in use."""

    engine: Any

    def function(self, name: str, *argument_types: Any) -> Any:
        """Return the function `name`, which takes ctypes arguments and returns nothing."""
        address = self.engine.get_function_address(name)
        return ctypes.CFUNCTYPE(None, *argument_types)(address)


def compile_ir(ir: str, *, optimise: int = 2) -> Module:
    """Compile the IR text `ir` for the processor at hand with optimisation level `optimise`."""
    from llvmlite import binding as llvm

    _initialise()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=optimise,
        jit=True,
    )
    module = llvm.parse_assembly(ir)
    module.verify()
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(optimise))
    builder.getModulePassManager().run(module, builder)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    return Module(engine)
