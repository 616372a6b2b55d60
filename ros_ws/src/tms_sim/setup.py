from setuptools import find_packages, setup

NAME = "tms_sim"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    package_data={
        NAME: [
            "py.typed",
            "floors/*.yaml",
            "imus/*.yaml",
            "interventions/*.yaml",
            "scenarios/*.yaml",
            "wheels/*.yaml",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    python_requires=">=3.10,<3.14",
    install_requires=[
        "setuptools",
        "imufusion>=1.2,<2",
        "matplotlib>=3.6",
        "numpy>=1.26",
        "PyYAML>=6",
        "scipy>=1.11",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="TMS maintainers",
    maintainer_email="maintainers@example.org",
    description="Simulated runs of bicycles and the simulator node.",
    license="Apache-2.0",
    entry_points={"console_scripts": ["simulator = tms_sim.nodes.executables:simulator"]},
)
