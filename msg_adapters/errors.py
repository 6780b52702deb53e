"""What an adapter raises."""


class MessageError(ValueError):
    """A message that must be dropped: says which field is wrong and why."""
