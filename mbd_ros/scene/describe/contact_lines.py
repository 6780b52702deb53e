"""What `mbd-ros check` says of a contact: its bodies, its features, and who can integrate it."""

from typing import Any

from mbd_ros.core.inverse_dynamics.reach import listed
from mbd_ros.core.multiplier_laws import Kind


def contact_words(part: Any) -> str:
    """Bodies and features, and whether events of a rigid contact can be found.

    Args:
        part: A contact.
    """
    a, b = part.pair.between
    count = f"{len(part.features)} features: " if len(part.features) > 1 else ""
    text = f"between {a.frame} and {b.frame}, {count}{listed(part.features)}"
    law = getattr(part, "law", None)
    if law is None or law.kind is not Kind.CONE:
        return text
    if part.pair.is_smooth:
        return f"{text}; smooth, for event-driven integrators and moreau_jean"
    return f"{text}; for moreau_jean, not event-driven: {part.pair.why_not}"
