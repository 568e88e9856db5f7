"""Build description of finger_operator (pip and colcon)."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "finger_operator"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="The guided study and the operator's page of the finger contact suite.",
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
    package_data={PACKAGE: ["data/*", "data/**/*", "page/static/*"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "protocol_node = finger_operator.protocol_node:main",
            "page_node = finger_operator.page_node:main",
        ],
    },
)
