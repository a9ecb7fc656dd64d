"""
Makes docs/api of packaging/docs/api: each line `::: NAME` of a page there becomes what the source
says of a public name, its signature and docstring. Reads the source, and imports nothing.
usage: reference.py [--check]
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections.abc import Iterator
from functools import cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
TEMPLATES = Path(__file__).parent / "api"
PAGES = ROOT / "docs" / "api"

HEAD = "<!-- Generated from the docstrings by packaging/docs/reference.py; do not edit. -->\n\n"

INTERNAL = re.compile(
    r"_|(note|note_\w+|abandon|answer_chunk|take_state_of|with_state_of|take_worst|close_later"
    r"|scaling_for|cells_of_one|masks_of|judge|scale_sources|found_in)$"
)
"""Members that are private, or that parts of the package call of each other."""

SECTIONS = {
    "Args:": "Arguments",
    "Attributes:": "Attributes",
    "Raises:": "Exceptions",
    "Returns:": "Returns",
}

Function = ast.FunctionDef | ast.AsyncFunctionDef

WIDTH = 100


class Named(NamedTuple):
    """A name of the source: its module, and its definition there."""

    module: str
    node: ast.stmt | ast.Module


def file_of(module: str) -> Path:
    """Return the file of a module; of a package with a stub, the stub."""
    path = ROOT.joinpath(*module.split("."))
    names = (path / "__init__.pyi", path / "__init__.py", path.with_suffix(".py"))
    return next((name for name in names if name.exists()), names[-1])


@cache
def tree_of(module: str) -> ast.Module:
    return ast.parse(file_of(module).read_text(encoding="utf-8"))


def statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield the statements of a body, and those below an `if`."""
    for node in body:
        if isinstance(node, ast.If):
            yield from statements([*node.body, *node.orelse])
        else:
            yield node


def imported(module: str, node: ast.ImportFrom) -> str:
    """Return the module from which a statement imports."""
    if not node.level:
        return node.module or ""
    is_package = file_of(module).stem == "__init__"
    parts = module.split(".")
    parts = parts[: len(parts) - node.level + is_package]
    return ".".join([*parts, *([node.module] if node.module else [])])


def named(module: str, name: str) -> Named | None:
    """Return the definition of a name, which other modules may have."""
    starred = None
    for node in statements(tree_of(module).body):
        if isinstance(node, ast.ClassDef | Function) and node.name == name:
            return Named(module, node)
        if isinstance(node, ast.Assign | ast.AnnAssign) and name in targets(node):
            return Named(module, node)
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                if alias.name == "*":
                    starred = named(imported(module, node), name)
                elif (alias.asname or alias.name) == name and alias.name != "__getattr__":
                    return resolved(f"{imported(module, node)}.{alias.name}")
    return starred


def targets(node: ast.Assign | ast.AnnAssign) -> list[str]:
    parts = node.targets if isinstance(node, ast.Assign) else [node.target]
    return [part.id for part in parts if isinstance(part, ast.Name)]


def resolved(path: str) -> Named | None:
    """Return what a path such as libmodbus_py.scan.Scan names."""
    if not path.startswith("libmodbus_py"):
        return None
    if file_of(path).exists():
        for node in tree_of(path).body:
            if ast.unparse(node).startswith("sys.modules[__name__] = "):  # a short path
                return named(path, ast.unparse(node).rpartition(" ")[2])
        return Named(path, tree_of(path))
    module, _, name = path.rpartition(".")
    return named(module, name) if file_of(module).exists() else None


def public_names(module: str) -> list[str]:
    """Return the names of a module that are public: `__all__`, or what the stub imports."""
    found = named(module, "__all__") if file_of(module).suffix != ".pyi" else None
    if found and isinstance(found.node, ast.Assign) and isinstance(found.node.value, ast.List):
        return [str(ast.literal_eval(name)) for name in found.node.value.elts]
    imports = [node for node in tree_of(module).body if isinstance(node, ast.ImportFrom)]
    return [alias.name for node in imports if node.module for alias in node.names]


# --- texts --------------------------------------------------------------------------------------


def markdown(docstring: str) -> str:
    """Return a docstring with its sections as Markdown."""
    lines = []
    section = ""
    for line in inspect.cleandoc(docstring).splitlines():
        if line in SECTIONS:
            section = line
            lines += [f"**{SECTIONS[section]}**", ""]
            continue
        if not line.startswith(" ") and line:
            section = ""
        entry = re.fullmatch(r" {4}(\w+(?:, \w+)*): ?(.*)", line) if section != "Returns:" else None
        if section and entry:
            names = ", ".join(f"`{name.strip()}`" for name in entry[1].split(","))
            lines.append(f"- {names}: {entry[2]}")
        elif section and section != "Returns:" and line.startswith(" " * 8):
            lines.append(line[6:])
        else:
            lines.append(line.removeprefix(" " * 4) if section else line)
    text = re.sub(r"(?<!`)``(?!`)(.+?)``", r"`\1`", "\n".join(lines)).strip()
    text = re.sub(r"(?m)^::\n\n", "", text)  # before code, which is indented
    return re.sub(r"(?ms)^=+ [= ]+\n.*^=+ [= ]+$", r"```text\n\g<0>\n```", text)


def text_of(node: ast.AST) -> str:
    """Return an annotation or a default as code."""
    return re.sub(r"'([^'\"]*)'", r'"\1"', ast.unparse(node))


def annotation(node: ast.expr | None) -> str:
    """Return an annotation without quotation marks, and without what is `Annotated`."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    return re.sub(r"ClassVar\[(.*)\]", r"\1", text_of(node)) if node else ""


def parameters(function: Function, *, is_method: bool) -> list[str]:
    """Return the parameters of a function, without `self` and `**wrong`, which only has errors."""
    arguments = function.args
    positional = [*arguments.posonlyargs, *arguments.args]
    missing = len(positional) - len(arguments.defaults)
    parts = []
    for number, argument in enumerate(positional):
        default = arguments.defaults[number - missing] if number >= missing else None
        if number or not is_method:
            parts.append(parameter(argument, default))
        if argument in arguments.posonlyargs[-1:]:
            parts.append("/")
    parts = parts[1:] if parts[:1] == ["/"] else parts
    if arguments.vararg:
        parts.append(f"*{parameter(arguments.vararg, None)}")
    elif arguments.kwonlyargs:
        parts.append("*")
    pairs = zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    parts += [parameter(argument, default) for argument, default in pairs]
    if arguments.kwarg and arguments.kwarg.arg != "wrong":
        parts.append(f"**{parameter(arguments.kwarg, None)}")
    return parts


def parameter(argument: ast.arg, default: ast.expr | None) -> str:
    kind = annotation(argument.annotation)
    text = f"{argument.arg}: {kind}" if kind else argument.arg
    return f"{text}{' = ' if kind else '='}{text_of(default)}" if default else text


def signature(name: str, parts: list[str], result: str) -> str:
    line = f"{name}({', '.join(parts)}){result}"
    if len(line) > WIDTH and parts:
        rows = "".join(f"    {part},\n" for part in parts)
        return f"{name}(\n{rows}){result}"
    return line


def of_function(function: Function, name: str, *, is_method: bool = False) -> str:
    is_async = isinstance(function, ast.AsyncFunctionDef)
    parts = parameters(function, is_method=is_method and "staticmethod" not in marks(function))
    result = annotation(function.returns)
    whole = signature(name, parts, f" -> {result}" if result else "")
    return f"{'async ' if is_async else ''}{whole}"


def marks(node: ast.AST) -> set[str]:
    """Return the names of the decorators of a definition."""
    return {re.split(r"[.(]", ast.unparse(mark))[-1 if "." in ast.unparse(mark) else 0]
            for mark in getattr(node, "decorator_list", [])}  # fmt: skip


# --- classes ------------------------------------------------------------------------------------


@cache
def described() -> set[str]:
    """Return the names that the pages have: what inherits from one need not repeat its members."""
    lines = [line for page in TEMPLATES.glob("*.md") for line in names_of(page.read_text())]
    modules = [found.module for line in lines if (found := resolved(line))
               and isinstance(found.node, ast.Module)]  # fmt: skip
    return {*[line.rpartition(".")[2] for line in lines], *chain(*map(public_names, modules))}


def names_of(template: str) -> list[str]:
    return re.findall(r"(?m)^::: (\S+)$", template)


def base_names(found: Named) -> list[str]:
    """Return the names of the bases of a class, without parameters."""
    assert isinstance(found.node, ast.ClassDef)
    names = [ast.unparse(base).partition("[")[0] for base in found.node.bases]
    return [name for name in names if re.match(r"(?!_|ABC$|Generic$)\w+$", name)]


def classes_of(found: Named) -> list[Named]:
    """Return a class and the classes of the package that it inherits from and pages do not have."""
    classes = [found]
    assert isinstance(found.node, ast.ClassDef)
    for base in found.node.bases:
        name = ast.unparse(base).partition("[")[0]
        above = named(found.module, name) if name not in described() else None
        if above and isinstance(above.node, ast.ClassDef):
            classes += classes_of(above)
    return classes


def constructor(found: Named) -> str:
    """Return the signature of a class, or its bases if it has no constructor of its own."""
    assert isinstance(found.node, ast.ClassDef)
    name = found.node.name
    fields: dict[str, str] = {}
    for _, node in reversed(classes_of(found)):
        assert isinstance(node, ast.ClassDef)
        for member in node.body:
            if isinstance(member, Function) and member.name == "__init__":
                fields = {part: part for part in parameters(member, is_method=True)}
            elif "dataclass" in marks(node) or "NamedTuple" in map(ast.unparse, node.bases):
                fields |= field_of(member)
    bases = ", ".join(base_names(found))
    return (
        signature(f"class {name}", [*fields.values()], "") if fields else f"class {name}({bases})"
    )


def field_of(member: ast.stmt) -> dict[str, str]:
    """Return the parameter of a dataclass that a statement of its body makes."""
    if not isinstance(member, ast.AnnAssign) or not isinstance(member.target, ast.Name):
        return {}
    if member.target.id.startswith("_"):
        return {}
    kind, value = annotation(member.annotation), member.value
    if kind.startswith("ClassVar") or "ClassVar" in ast.unparse(member.annotation):
        return {}
    default = f" = {text_of(value)}" if value else ""
    if isinstance(value, ast.Call) and ast.unparse(value.func) == "field":
        options = {key.arg: key.value for key in value.keywords}
        if "init" in options and not ast.literal_eval(options["init"]):
            return {}
        factory = options.get("default_factory")
        made = factory.body if isinstance(factory, ast.Lambda) else factory
        called = "" if made is not factory else "()"
        default = f" = {text_of(made)}{called}" if made else ""
        default = f" = {text_of(options['default'])}" if "default" in options else default
    return {member.target.id: f"{member.target.id}: {kind}{default}"}


def members(found: Named) -> dict[str, list[ast.stmt | str]]:
    """Return the public members of a class: name -> definitions, with overloads, and docstring."""
    result: dict[str, list[ast.stmt | str]] = {}
    for _, node in classes_of(found):
        assert isinstance(node, ast.ClassDef)
        own: dict[str, list[ast.stmt | str]] = {}
        for number, member in enumerate(node.body):
            if isinstance(member, Function):
                if not marks(member) & {"setter", "deleter"}:
                    own.setdefault(member.name, []).append(member)
            elif isinstance(member, ast.Assign | ast.AnnAssign):
                after = node.body[number + 1 : number + 2]
                if text := "".join(map(text_in, after)):
                    own |= {name: [member, text] for name in targets(member)}
        result = {**result, **{name: own[name] for name in own if name not in result}}
    return {name: parts for name, parts in result.items() if not INTERNAL.match(name)}


def of_member(name: str, parts: list[ast.stmt | str], owner: str, level: str) -> str:
    """Return the heading, signature and docstring of a member."""
    last = parts[-1]
    if isinstance(last, str):
        node = parts[0]
        assert isinstance(node, ast.Assign | ast.AnnAssign)
        kind = annotation(node.annotation) if isinstance(node, ast.AnnAssign) else ""
        shown = f"{name}: {kind}" if kind else name
        text = last
    else:
        assert isinstance(last, Function)
        text = ast.get_docstring(last) or ""
        overloads = [part for part in parts if isinstance(part, Function) and len(parts) > 1]
        overloads = [part for part in overloads if "overload" in marks(part)] or [last]
        text = text or next((ast.get_docstring(part) or "" for part in overloads), "")
        if not text:
            return ""
        if marks(last) & {"property", "cached_property"}:
            shown = f"{name}: {annotation(last.returns)}"
        else:
            shown = "\n".join(of_function(part, name, is_method=True) for part in overloads)
    return f"{level} {owner}.{name}\n\n```python\n{shown}\n```\n\n{markdown(text)}\n"


def of_class(found: Named, name: str, level: str, like: Named | None = None) -> str:
    """Return what is said of a class; of one that is like another, only what differs."""
    node = found.node
    assert isinstance(node, ast.ClassDef)
    head = constructor(found).removesuffix("()")
    parts = [f"{level} {name}\n\n```python\n{head}\n```\n"]
    if text := ast.get_docstring(node):
        parts.append(markdown(text) + "\n")
    inherited = [f"`{base}`" for base in base_names(found) if base in described()]
    if inherited and not head.endswith(f"({', '.join(base_names(found))})"):
        parts.append(f"Inherits from {', '.join(inherited)}.\n")
    if "Enum" in base_names(found):
        values = [target for part in node.body if isinstance(part, ast.Assign)
                  for target in targets(part) if target[0] != "_"]  # fmt: skip
        parts.append(f"Members: {', '.join(f'`{value}`' for value in values)}\n")
    own = members(found)
    other = members(like) if like else {}
    same = [key for key in own if key in other and docstring(own[key]) == docstring(other[key])]
    if same:
        names = ", ".join(f"`{key}`" for key in same)
        parts.append(f"These are as in `Client`; the methods are awaited: {names}.\n")
    for member, definitions in own.items():
        if member not in same:
            parts.append(of_member(member, definitions, name, f"{level}#"))
    return "\n".join(filter(None, parts))


def docstring(parts: list[ast.stmt | str]) -> str:
    texts = [part if isinstance(part, str) else ast.get_docstring(part) or "" for part in parts
             if isinstance(part, str | Function)]  # fmt: skip
    return "".join(texts)


def of_name(path: str, level: str = "##") -> str:
    """
    Return the Markdown of a public name.

    Raises:
        LookupError: the source has no such name.
    """
    name = path.rpartition(".")[2]
    found = resolved(path)
    if found is None:
        raise LookupError(f"{path} does not exist")
    if isinstance(found.node, ast.ClassDef):
        like = resolved("libmodbus_py.Client") if name == "AsyncClient" else None
        return of_class(found, name, level, like)
    if isinstance(found.node, Function):
        text = markdown(ast.get_docstring(found.node) or "")
        return f"{level} {name}\n\n```python\n{of_function(found.node, name)}\n```\n\n{text}\n"
    if isinstance(found.node, ast.Module):
        return of_module(found.module, path, level)
    return f"{level} {name}\n\n{markdown(text_after(found))}\n"


def text_in(node: ast.stmt) -> str:
    """Return the text that a statement consists of, which is a docstring, or nothing."""
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return str(node.value.value) if is_text else ""  # type: ignore[attr-defined]


def text_after(found: Named) -> str:
    """Return the docstring below an assignment of a module, or what is assigned."""
    body = [*statements(tree_of(found.module).body)]
    after = body[body.index(found.node) + 1 :][:1]  # type: ignore[arg-type]
    return "".join(map(text_in, after)) or f"```python\n{text_of(found.node)}\n```"


def of_module(source: str, path: str, level: str) -> str:
    """Return what is said of a module and of all its public names."""
    # What C defines has no source here: pages name it themselves.
    names = [name for name in public_names(source) if resolved(f"{source}.{name}")]
    text = ast.get_docstring(ast.parse(file_of(source).with_suffix(".py").read_text())) or ""
    whole = [f"{level} {path}\n\n{markdown(text)}\n"]
    return "\n".join(whole + [of_name(f"{source}.{name}", f"{level}#") for name in names])


def page(template: str) -> str:
    """Return a page of a template."""
    body = re.sub(r"(?m)^::: (\S+)$", lambda line: of_name(line[1]).strip(), template)
    return HEAD + re.sub(r"\n{3,}", "\n\n", body)


def main() -> int:
    is_check = sys.argv[1:] == ["--check"]
    status = 0
    for template in sorted(TEMPLATES.glob("*.md")):
        path = PAGES / template.name
        text = page(template.read_text(encoding="utf-8"))
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            done = "not what reference.py makes" if is_check else "written"
            print(f"{path.relative_to(ROOT)}: {done}")
            status = int(is_check)
            if not is_check:
                path.parent.mkdir(exist_ok=True)
                path.write_text(text, encoding="utf-8")
    return status


if __name__ == "__main__":
    sys.exit(main())
