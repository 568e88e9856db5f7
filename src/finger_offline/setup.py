"""Build description of finger_offline (pip and colcon)."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "finger_offline"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Offline work on finger contact bags: vision and model over a recording, trials, tables.",
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
        "console_scripts": [],
    },
)
