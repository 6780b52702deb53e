"""Numbers of an attribute and links of a joint, from a checked URDF."""

from xml.etree import ElementTree


def numbers(element: ElementTree.Element | None, attribute: str, default: str) -> list[float]:
    """Numbers of one attribute that has been checked before."""
    text = default if element is None else element.get(attribute, default)
    return [float(word) for word in text.split()]


def link_name(joint: ElementTree.Element, role: str) -> str:
    """Name of the `parent` or `child` link of a checked joint."""
    element = joint.find(role)
    assert element is not None
    return element.get("link", "")


def joint_kinds(tree: ElementTree.Element) -> dict[str, str]:
    """Joint -> its type."""
    return {e.get("name", ""): e.get("type", "") for e in tree.findall("joint")}


def has_effort_limit(joint: ElementTree.Element) -> bool:
    """Whether the description limits the effort of a joint."""
    limit = joint.find("limit")
    return limit is not None and "effort" in limit.attrib
