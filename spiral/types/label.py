"""An effect's name in a model, ``NAME@PORT#VARIANT``: port and variant may be absent."""


def make_label(name: str, port: str = "", variant: str = "") -> str:
    """``cubic_stiffness``, ``cubic_stiffness@bearing_2`` or ``cubic_stiffness@bearing_2#3``."""
    return name + (f"@{port}" if port else "") + (f"#{variant}" if variant else "")


def split_port(label: str) -> tuple[str, str]:
    """The name and the port of a label as users write it, which has no variant."""
    name, _, port = label.partition("@")
    return name, port


def split_variant(label: str) -> tuple[str, str]:
    """The label without its variant, and the variant, which tells copies in one study apart."""
    plain, _, variant = label.partition("#")
    return plain, variant


def name_of(label: str) -> str:
    """The effect's name alone."""
    return split_port(split_variant(label)[0])[0]
