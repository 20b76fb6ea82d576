from roadsight.api.alignment import align as align
from roadsight.api.clouds import Cloud as Cloud
from roadsight.api.clouds import read_cloud as read_cloud
from roadsight.api.costs import estimate as estimate
from roadsight.api.covers import cover as cover
from roadsight.api.scene import edges as edges
from roadsight.api.scene import ground as ground
from roadsight.api.scene import pavement as pavement
from roadsight.api.sight import depth_map as depth_map
from roadsight.api.sight import detection_matrix as detection_matrix
from roadsight.api.sightings import triangulate as triangulate
from roadsight.base.errors import InputError as InputError
from roadsight.base.sections.scene import GroundFilter as GroundFilter
from roadsight.base.sections.sensing import Targets as Targets
from roadsight.placement.sensors.sensors import Sensor as Sensor
from roadsight.poles.triangulate.rays import TriangulationSettings as TriangulationSettings
from roadsight.scene.whole import FoundRoad as FoundRoad
from roadsight.setcover import Cover as Cover

__version__: str
