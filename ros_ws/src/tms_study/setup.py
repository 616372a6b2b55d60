from setuptools import find_packages, setup

NAME = "tms_study"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/experiment.launch.py"]),
    ],
    python_requires=">=3.10,<3.14",
    install_requires=["setuptools", "matplotlib>=3.6", "numpy>=1.26", "scipy>=1.11", "tqdm>=4.66"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="TMS maintainers",
    maintainer_email="maintainers@example.org",
    description="What needs both simulator and estimators.",
    license="Apache-2.0",
)
