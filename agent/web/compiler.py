"""numba's kernels, compiled to WebAssembly: the same functions, and the same bits, as in Python.

numba compiles them without its own optimizers, which would bind them to this machine, in a process
of its own. LLVM then has them optimized for wasm32, without vectorizers, and ziglang links them
with the motors' C. A kernel of the module takes the address of its arguments, see
`agent.web.image`.
"""

import importlib.util
import os
import pickle
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numba

from cosim.base.errors import UserError
from cosim.base.jit import TRANSIENT, digest_of_sources
from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached, write_whole
from fmus.build import instantiation_token
from fmus.compiler import SAME_BITS, compiler_command, fmi_headers, run_compiler, source_files
from fmus.description import render_header

Kernels = Mapping[str, str]  # names in the module, and "module:name" in Python


class Module(NamedTuple):
    """A WebAssembly module, and the name of its file in the cache and in the wheel."""

    name: str
    content: bytes


C = Path(__file__).with_name("c")
CACHED = "web"  # the kind of modules in the cache
TARGET = "wasm32-wasi"
# What numba's optimizers and its processor are in the process that compiles.
_PLAIN = {
    "NUMBA_OPT": "0",
    "NUMBA_LOOP_VECTORIZE": "0",
    "NUMBA_SLP_VECTORIZE": "0",
    "NUMBA_CPU_NAME": "generic",
    "NUMBA_CPU_FEATURES": "",
    TRANSIENT: "yes",
}
_FEATURES = "+simd128,+bulk-memory,+sign-ext,+nontrapping-fptoint,+mutable-globals"
_EXPORTED = (
    *("room", "address_of", "restore_motors", "seed_generator", "fill_uniforms"),
    "__global_base",  # where memory begins that outlives a call: below it is the stack
)
_FLAGS = ("-target", TARGET, "-mexec-model=reactor", "-msimd128", "-O3", "-g0", "-s", SAME_BITS)
_MODEL = "VibrationMotors"
# Functions whose last bits each C library has for itself, as LLVM calls them; log10 counts digits
# in texts of errors.
_OF_LIBRARY = re.compile(
    r"call [^\n]*@(?:llvm\.)?((?:a?(?:sin|cos|tan)|exp(?!eri)|log(?!10)|pow|hypot|cbrt)\w*)[.(]"
)
_PARAMETER = re.compile(r", (?=(?:ptr|i\d+|double|float)\b)")


def compiled(kernels: Kernels, record: tuple[Any, ...]) -> Module:
    """Return a module of kernels that take a record like this one; cache or wheel may have it.

    Raises a UserError where ziglang is missing or fails.
    """
    sources = digest_of_sources(Path(__file__).parents[2]), *sorted(C.glob("*.c"))
    asked = dict(kernels), str(numba.typeof(record)), _PLAIN, _FLAGS, _FEATURES
    # Nothing of the compilers: any of them gives these bits. A saved state of motors has the token.
    name = f"{digest_of(*sources, *asked, instantiation_token(_MODEL))}.wasm"

    def save(module: bytes, path: Path) -> None:
        write_whole(path, module)

    path = cache_dir(CACHED) / name
    return Module(name, cached(path, Path.read_bytes, lambda: _compile(kernels, record), save))


def _compile(kernels: Kernels, record: tuple[Any, ...]) -> bytes:
    if not importlib.util.find_spec("ziglang"):
        raise UserError(
            "the kernels of this page are compiled by ziglang, which is missing: install the extra "
            "`build`; wheels have those of most pages of the paper's robot"
        )
    with TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "asked").write_bytes(pickle.dumps((kernels, record)))
        command = [sys.executable, "-c", f"from {__name__} import main; main()"]
        run = subprocess.run(
            command, cwd=work, env=_environment(), capture_output=True, text=True, check=False
        )
        if run.returncode:
            raise UserError(f"numba failed to compile the page's kernels: {run.stderr[-2000:]}")
        header = render_header(_MODEL, instantiation_token(_MODEL))
        for name, content in source_files(_MODEL, "3", header).items():
            (work / name).write_bytes(content)
        units = ["kernels.o", *map(str, sorted(C.glob("*.c")))]
        exported = [f"-Wl,--export={name}" for name in (*_EXPORTED, *kernels)]
        command = [*compiler_command(), *_FLAGS, *exported, f"-I{work}", f"-I{fmi_headers()}"]
        run_compiler([*command, *units, "-o", "page.wasm"], work, "the page")
        return (work / "page.wasm").read_bytes()


def _environment() -> dict[str, str]:
    paths = os.pathsep.join(path for path in sys.path if path)
    return os.environ | _PLAIN | {"PYTHONPATH": paths}


def main() -> None:
    """Compile what the file `asked` has to kernels.o, both in the present folder."""
    kernels, record = pickle.loads(Path("asked").read_bytes())
    Path("kernels.o").write_bytes(_object_of(kernels, (numba.typeof(record),)))


def _object_of(kernels: Kernels, types: tuple[Any, ...]) -> bytes:
    """Return an object file for wasm32 with a function for each kernel."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(TARGET)
    machine = target.create_target_machine(features=_FEATURES, opt=3, reloc="static")
    module = llvm.parse_assembly("")
    module.triple, module.data_layout = TARGET, str(machine.target_data)
    inner = []
    for export, kernel in kernels.items():
        place, name = kernel.split(":")
        function = getattr(importlib.import_module(place), name)
        function.compile(types)
        result = function.overloads[types]
        name, text = result.fndesc.llvm_func_name, result.library.get_llvm_str()
        inner.append(name)
        module.link_in(llvm.parse_assembly(_entry(export, name, text)))  # which asks for the rest
        module.link_in(llvm.parse_assembly(_retargeted(text)))
    for value in (*module.functions, *module.global_variables):
        if not value.is_declaration and value.name not in kernels:
            value.linkage = "internal"
    for name in inner:  # which have more parameters than WebAssembly allows
        module.get_function(name).add_function_attribute("alwaysinline")
    module.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = False
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    if found := sorted(set(_OF_LIBRARY.findall(str(module)))):
        raise UserError(
            f"kernels call {', '.join(found)} of the C library, whose bits differ from machine to "
            "machine; have the project's own compute it, as `cosim.physics.trig` does"
        )
    return machine.emit_object(module)


def _retargeted(text: str) -> str:
    """Return LLVM's text of a kernel for no target; what two kernels call may be in both."""
    text = re.sub(r"^target .*$", "", text, flags=re.MULTILINE)
    # Counting references to arrays is most of planning if every count is a call.
    text = re.sub(r"^(attributes .*)\bnoinline\b", r"\1nounwind", text, flags=re.MULTILINE)
    kinds = "internal|private|linkonce|linkonce_odr|available_externally"
    return re.sub(rf"^define (?!{kinds}\b)", "define linkonce_odr ", text, flags=re.MULTILINE)


def _entry(export: str, name: str, text: str) -> str:
    """Return LLVM's text of a function that calls a kernel with arguments from slots of 8 bytes.

    It returns the kernel's whole number, or −1000 where the kernel raised an error.
    """
    line = re.search(rf"^define [^\n]*@{re.escape(name)}\((.*)\)[^)\n]*\{{", text, re.MULTILINE)
    assert line is not None
    kinds = [parameter.split()[0] for parameter in _PARAMETER.split(line[1])]
    loads = [
        f"  %p{k} = getelementptr i64, ptr %slots, i32 {k}\n  %v{k} = load {kind}, ptr %p{k}"
        for k, kind in enumerate(kinds[2:])
    ]
    passed = ["ptr %result", "ptr %error", *(f"{kind} %v{k}" for k, kind in enumerate(kinds[2:]))]
    return "\n".join(
        [
            f"declare i32 @{name}({', '.join(kinds)})",
            f"define i32 @{export}(ptr %slots) {{",
            "  %result = alloca [8 x i64]",
            "  %error = alloca ptr",
            "  store i64 0, ptr %result",
            *loads,
            f"  %status = call i32 @{name}({', '.join(passed)})",
            "  %whole = load i64, ptr %result",
            "  %value = trunc i64 %whole to i32",
            "  %raised = icmp ne i32 %status, 0",
            "  %returned = select i1 %raised, i32 -1000, i32 %value",
            "  ret i32 %returned",
            "}",
        ]
    )
