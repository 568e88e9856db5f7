"""Build description of finger_sim (pip and colcon)."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "finger_sim"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="The simulated finger, FTIR renderer, rig and study.",
    license="Apache-2.0",
    maintainer="Finger contact suite maintainers",
    maintainer_email="maintainers@finger-contact.example",
    python_requires=">=3.10",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", glob("launch/*.py")),
        (f"share/{PACKAGE}/config", glob("config/*")),
    ],
    package_data={PACKAGE: ["data/*", "data/**/*"]},
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "rig_node = finger_sim.rig_node:main",
        ],
    },
)
