from roadsight.api.clouds import read_cloud as read_cloud
from roadsight.api.costs import estimate as estimate
from roadsight.api.covers import cover as cover
from roadsight.api.drive import align as align
from roadsight.api.scene import edges as edges
from roadsight.api.scene import ground as ground
from roadsight.api.scene import pavement as pavement
from roadsight.api.sight import depth_map as depth_map
from roadsight.api.sight import detection_matrix as detection_matrix
from roadsight.api.sightings import triangulate as triangulate

__version__: str
