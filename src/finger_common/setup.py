# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Build description for pip and colcon: facts from package.xml, entry points in setup.cfg."""

from glob import glob
from xml.etree import ElementTree

from setuptools import find_packages, setup

package = ElementTree.parse("package.xml").getroot()
name = package.findtext("name")
maintainer = package.find("maintainer")

setup(
    name=name,
    version=package.findtext("version"),
    description=package.findtext("description"),
    license=package.findtext("license"),
    maintainer=maintainer.text,
    maintainer_email=maintainer.get("email"),
    python_requires=">=3.10",
    packages=find_packages(exclude=["test"]),
    package_data={name: ["data/*", "data/**/*", "*/static/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (f"share/{name}", ["package.xml"]),
        (f"share/{name}/launch", glob("launch/*.py")),
        (f"share/{name}/config", glob("config/*")),
        (f"share/{name}/urdf", glob("urdf/*")),
    ],
)
