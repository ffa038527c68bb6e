from glob import glob

from setuptools import find_packages, setup

package_name = 'herding_ros'

setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(include=[package_name, package_name + '.*']),
    package_data={package_name: ['py.typed', 'nodes/fastdds.xml', 'studies/pages/*.md']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
        ('share/' + package_name + '/config', glob('config/*.yaml')),
        ('share/' + package_name + '/launch', glob('launch/*.launch.py')),
        ('share/' + package_name + '/rviz', glob('rviz/*.rviz')),
    ],
    install_requires=['setuptools'],
    zip_safe=False,
    maintainer='herding_ros maintainers',
    maintainer_email='maintainers@herding-ros.org',
    description=(
        'Herds a randomly moving crowd with a few robots '
        'by space-mapping receding-horizon optimal control'
    ),
    license='Apache-2.0',
    extras_require={'test': ['pytest']},
    entry_points={
        'console_scripts': [
            'controller = herding_ros.nodes.controller:main',
            'herd = herding_ros.nodes.herd:main',
            'recorder = herding_ros.nodes.recorder:main',
            'recover = herding_ros.bag.cli:main',
            'report = herding_ros.report.cli:main',
            'sim = herding_ros.nodes.sim:main',
            'study = herding_ros.studies.cli:main',
        ],
    },
)
