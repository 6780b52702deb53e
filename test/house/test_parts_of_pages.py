"""The parts that pages show are whole: each page has the modules that tests take from it."""

import ast

import parts_of_pages


def test_the_modules_of_pages_define_the_parts_that_tests_build(tmp_path):
    parts_of_pages.write(tmp_path)
    named = {name for parts in parts_of_pages.OUTSIDE.values() for name in parts}
    defined = {
        f"{file.stem}:{node.name}"
        for file in tmp_path.glob("*.py")
        for node in ast.parse(file.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef)
    }
    assert named <= defined
