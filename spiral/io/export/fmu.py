"""A model as an FMU (FMI 2.0 or 3.0): the exported C with the interface around it.

The standard is at https://fmi-standard.org; the archive holds the source and a binary of this
machine. The description lists every state, input, reading and parameter with its unit, parameters
with their estimates as start values and their standard errors in words.
"""

from __future__ import annotations

import io
import platform
import shutil
import subprocess
import tempfile
import uuid
import zipfile
from pathlib import Path
from xml.etree import ElementTree as Xml

from spiral.io.export.c import c
from spiral.io.export.fmu_description import (
    documentation_page,
    fmi2_description,
    fmi3_description,
    xml_text,
)
from spiral.io.export.names import sanitise_text
from spiral.io.export.program import Program
from spiral.io.writing import fill_template
from spiral.types.errors import ConfigError

_COMPILERS = ("cc", "gcc", "clang")
_FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden")
_TIME = (1980, 1, 1, 0, 0, 0)  # of every file in the archive: the same model, the same bytes


def fmu(program: Program) -> bytes:
    """The FMU (zip archive) for FMI 2.0.

    Raises
    ------
    ConfigError : no C compiler here, or one that fails.
    """
    sources, token = _source_files(program, "fmi2")
    return _pack_archive(
        program, sources, xml_text(fmi2_description(program, token)), _fmi2_binary_folder()
    )


def fmu3(program: Program) -> bytes:
    """The FMU (zip archive) for FMI 3.0.

    Raises
    ------
    ConfigError : no C compiler here, or one that fails.
    """
    sources, token = _source_files(program, "fmi3")
    built = Xml.Element("fmiBuildDescription", fmiVersion="3.0")
    one = Xml.SubElement(built, "BuildConfiguration", modelIdentifier=program.name)
    Xml.SubElement(
        Xml.SubElement(one, "SourceFileSet", language="C99"), "SourceFile", name="fmi3.c"
    )
    archived = {**sources, "buildDescription.xml": xml_text(built)}
    return _pack_archive(
        program, archived, xml_text(fmi3_description(program, token)), _fmi3_binary_folder()
    )


def _source_files(program: Program, interface: str) -> tuple[dict[str, str], str]:
    """The C files by name, and the token that a description and its binary share."""
    source = c(program)
    token = "{" + str(uuid.uuid5(uuid.NAMESPACE_OID, source)) + "}"
    files = {
        f"{interface}.c": fill_template(f"export_{interface}", name=program.name),
        "instance.c": fill_template("export_fmi", name=program.name, guid=token),
        f"{program.name}.c": source,
    }
    return files, token


def _pack_archive(
    program: Program, sources: dict[str, str], description: str, folder: str
) -> bytes:
    suffix = {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")
    files: dict[str, str | bytes] = {
        "modelDescription.xml": description,
        "documentation/index.html": documentation_page(program),
        **{f"sources/{name}": text for name, text in sources.items()},
        f"binaries/{folder}/{program.name}{suffix}": _compile_library(sources),
    }
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as out:
        for name, content in files.items():
            out.writestr(zipfile.ZipInfo(name, _TIME), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def _fmi2_binary_folder() -> str:
    """Folder of this machine's binaries in FMI 2.0, such as ``linux64``."""
    names = {"Windows": "win64", "Darwin": "darwin64", "Linux": "linux64"}
    wide = platform.machine().lower() in ("x86_64", "amd64")
    return names.get(platform.system(), _fmi3_binary_folder()) if wide else _fmi3_binary_folder()


def _fmi3_binary_folder() -> str:
    """Folder of this machine's binaries in FMI 3.0, such as ``x86_64-linux``."""
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    return f"{machine}-{platform.system().lower()}"


def _compile_library(sources: dict[str, str]) -> bytes:
    """The C files, of which the first includes the others, as a shared library of this machine."""
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None:
        raise ConfigError(
            "export of an FMU on a machine without a C compiler",
            f"one of {', '.join(_COMPILERS)} on the path",
            "install one (gcc, for instance), or --to c",
        )
    with tempfile.TemporaryDirectory() as place:
        for name, text in sources.items():
            Path(place, name).write_text(text, encoding="utf-8")
        command = [compiler, *_FLAGS, "-o", "model", next(iter(sources)), "-lm"]
        done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise ConfigError(
                f"{compiler}: {sanitise_text(done.stderr) or done.returncode}",
                "a C99 compiler",
                "--to c",
            )
        return Path(place, "model").read_bytes()
