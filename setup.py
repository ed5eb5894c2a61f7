"""The packages of the wheel: three trees, found on disk so that none can be forgotten.

    spiral/ -> spiral        plugins/ -> spiral_plugins        conf/ -> spiral_conf

``pyproject.toml`` holds everything else; only this mapping of names cannot be written there.
"""

from setuptools import find_namespace_packages, find_packages, setup

# Folders of configurations hold YAML alone, so they are packages without an __init__.py.
TREES = {
    "spiral": ("spiral", find_packages),
    "plugins": ("spiral_plugins", find_packages),
    "conf": ("spiral_conf", find_namespace_packages),
}

setup(
    packages=[
        package.replace(folder, name, 1)
        for folder, (name, find) in TREES.items()
        for package in find(include=[folder, f"{folder}.*"], exclude=["*.__pycache__"])
    ],
    package_dir={name: folder for folder, (name, _) in TREES.items()},
)
