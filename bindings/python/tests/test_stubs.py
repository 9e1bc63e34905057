"""The stubs describe the compiled module."""

import ast
import inspect

import numpy as np
import pytest

import cfmmr
import cfmmr.algorithms
from cfmmr import _native
from conftest import PACKAGE

STUBS = ast.parse((PACKAGE / "_native.pyi").read_text(encoding="utf-8")).body


def parameters(node):
    """Names, kinds and defaults of a stub's parameters."""
    args = node.args
    positional = [*args.posonlyargs, *args.args]
    missing = [inspect.Parameter.empty] * (len(positional) - len(args.defaults))
    result = [(arg.arg, default) for arg, default in zip(positional, [*missing, *map(value, args.defaults)])]
    if args.vararg:
        result.append((f"*{args.vararg.arg}", inspect.Parameter.empty))
    result += [(f"{arg.arg}=", value(default)) for arg, default in zip(args.kwonlyargs, args.kw_defaults)]
    return [entry for entry in result if entry[0] not in ("self", "cls")]


def value(node):
    return ast.literal_eval(node)


def signature(item):
    """The same of the module's function or class."""
    result = []
    for name, parameter in inspect.signature(item).parameters.items():
        prefix = "*" if parameter.kind is parameter.VAR_POSITIONAL else ""
        suffix = "=" if parameter.kind is parameter.KEYWORD_ONLY else ""
        result.append((f"{prefix}{name}{suffix}", parameter.default))
    return [entry for entry in result if entry[0] != "self"]


def public(names):
    return {name for name in names if not name.startswith("_")}


CLASSES = {node.name: node for node in STUBS if isinstance(node, ast.ClassDef) and not node.name.startswith("_")}
FUNCTIONS = {node.name: node for node in STUBS if isinstance(node, ast.FunctionDef)}


def test_stubs_and_module_have_the_same_names():
    assert public(vars(_native)) == set(CLASSES) | set(FUNCTIONS)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function_has_the_parameters_of_its_stub(name):
    assert signature(getattr(_native, name)) == parameters(FUNCTIONS[name])


@pytest.mark.parametrize("name", CLASSES)
def test_class_has_the_members_of_its_stub(name):
    found, stub = getattr(_native, name), CLASSES[name]
    members = {node.name: node for node in stub.body if isinstance(node, ast.FunctionDef)}
    attributes = {node.target.id for node in stub.body if isinstance(node, ast.AnnAssign)}
    assert public(vars(found)) - {"field", "value", "allowed"} == public(members)
    assert all(hasattr(found, attribute) for attribute in attributes)
    for member, node in members.items():
        if member == "__new__":
            assert signature(found) == parameters(node)
        elif any(getattr(mark, "id", "") == "property" for mark in node.decorator_list):
            assert inspect.isdatadescriptor(vars(found)[member]), member
        else:
            assert signature(getattr(found, member)) == parameters(node), member


@pytest.mark.parametrize("name", CLASSES)
def test_everything_in_a_class_is_documented(name):
    found = getattr(_native, name)
    assert found.__doc__
    if "Input" not in name:
        assert all(getattr(found, member).__doc__ for member in public(vars(found)))


@pytest.mark.parametrize("module", [cfmmr, cfmmr.algorithms])
def test_all_names_that_a_module_exports_exist(module):
    assert all(hasattr(module, name) for name in module.__all__)


def test_every_algorithm_is_exported():
    private = {"drawn_json", "drawn_plant_json", "keys_json", "path_columns", "run_columns", "run_rows"}
    exported = {*cfmmr.__all__, *cfmmr.algorithms.__all__}
    assert public(vars(_native)) - private <= exported


def test_single_entries_of_a_stub_have_the_returned_types():
    robot = cfmmr.Robot(cfmmr.Scenario("careful"), 1)
    assert isinstance(robot.posture, np.ndarray) and isinstance(robot.notices, list)
    assert robot.fault is None and robot.done is False
