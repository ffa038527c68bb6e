# SPDX-License-Identifier: Apache-2.0
from glob import glob
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

# Name, version, description, licence and maintainer are those of package.xml.
manifest = ElementTree.parse(Path(__file__).resolve().with_name('package.xml'))
about = {each.tag: each for each in manifest.getroot()}
name = about['name'].text

LAYOUTS = ['config/foxglove.json', 'config/plotjuggler.xml']

setup(
    name=name,
    version=about['version'].text,
    description=about['description'].text,
    license=about['license'].text,
    maintainer=about['maintainer'].text,
    maintainer_email=about['maintainer'].get('email'),
    packages=find_packages(include=[name, name + '.*']),
    package_data={
        name: [
            'py.typed',
            'model/fields/*.yaml',
            'nodes/fastdds*.xml',
            'report/replay.html',
            'studies/pages/*.md',
        ]
    },
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + name]),
        ('share/' + name, ['package.xml']),
        ('share/' + name + '/config', [*glob('config/*.yaml'), *LAYOUTS]),
        ('share/' + name + '/launch', glob('launch/*.launch.py')),
        ('share/' + name + '/rviz', glob('rviz/*.rviz')),
    ],
    python_requires='>=3.10',
    # The oldest that serve: those of Ubuntu 24.04. requirements.txt pins what is tested.
    install_requires=['numpy>=1.26', 'scipy>=1.11', 'numba>=0.57', 'shapely>=2.0', 'pyyaml'],
    extras_require={
        'report': ['matplotlib', 'mcap>=1.2', 'pillow', 'pyyaml', 'rich', 'rosbags>=0.10'],
        'rerun': ['rerun-sdk>=0.41'],
        'view': ['viser>=1.1'],
        'study': ['matplotlib', 'rich', 'distributed'],
        'test': ['pytest'],
    },
    zip_safe=False,
    entry_points={
        'console_scripts': [
            'controller = herding_ros.programs:controller',
            'fit = herding_ros.programs:fit',
            'herd = herding_ros.programs:herd',
            'recorder = herding_ros.programs:recorder',
            'recover = herding_ros.programs:recover',
            'report = herding_ros.programs:report',
            'sim = herding_ros.programs:sim',
            'study = herding_ros.programs:study',
            'view = herding_ros.programs:view',
        ],
    },
)
