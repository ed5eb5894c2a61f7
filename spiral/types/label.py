"""Names in a model: an effect's label ``NAME@PORT#VARIANT``, a parameter's key ``OWNER.PARAMETER``.

Port and variant may be absent from a label. Nothing else takes these texts apart.
"""


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


def split_key(key: str) -> tuple[str, str]:
    """Owner (``system`` or an effect's label) and parameter of a key ``OWNER.PARAMETER``.

    The last dot separates, as the variant in a label may hold a number. A text without a dot is an
    owner.
    """
    owner, *parameter = key.rsplit(".", 1)
    return owner, parameter[0] if parameter else ""


def owner_of(key: str) -> str:
    """What a parameter's key belongs to: ``system`` or an effect's label."""
    return split_key(key)[0]


def without_variant(text: str) -> str:
    """A label or a key as users know it: ``overflow.rim`` for ``overflow#6.rim``."""
    owner, parameter = split_key(text)
    plain, _ = split_variant(owner)
    return f"{plain}.{parameter}" if parameter else plain


def parameter_of(key: str) -> str:
    """A parameter's name without its owner."""
    return split_key(key)[1]
