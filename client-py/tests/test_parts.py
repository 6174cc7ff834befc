"""Answers that come in parts."""

from percept._convert import geometry
from percept._convert.toolbox import kept
from percept._parts import joined
from percept.types.toolbox import Step
from percept.v1 import geometry_pb2, scene_service_pb2
from percept.v1 import toolbox_clouds_service_pb2 as clouds
from percept.v1 import toolbox_depth_service_pb2 as depth
from percept.v1 import toolbox_pipelines_service_pb2 as pipelines


def cloud(first: int, count: int) -> geometry_pb2.PointCloud:
    numbers = bytes(range(first, first + count))
    return geometry_pb2.PointCloud(
        num_points=count,
        positions=b"".join(bytes([n]) * 12 for n in numbers),
        colours=b"".join(bytes([n]) * 3 for n in numbers),
    )


def test_one_part_is_the_answer():
    alone = clouds.CropCloudResponse(cloud=cloud(0, 2), indices=b"\0\0\0\0")
    assert joined([alone]) is alone


def test_bytes_and_lists_go_on_and_all_else_stands_in_the_first_part():
    parts = [
        clouds.CropCloudResponse(cloud=cloud(0, 2)),
        clouds.CropCloudResponse(cloud=cloud(2, 3), indices=b"ab"),
        clouds.CropCloudResponse(indices=b"cd"),
    ]
    assert joined(parts) == clouds.CropCloudResponse(cloud=cloud(0, 5), indices=b"abcd")
    image = depth.FilterDepthResponse()
    image.depth.width_px = 7
    rest = depth.FilterDepthResponse()
    rest.depth.data = b"xyz"
    whole = joined([image, rest])
    assert (whole.depth.width_px, whole.depth.data) == (7, b"xyz")
    graphs = [scene_service_pb2.GetSceneGraphResponse() for _ in range(3)]
    for i, part in enumerate(graphs):
        part.graph.nodes.add().node_id = str(i)
    graphs[0].graph.map_version = 9
    graph = joined(graphs).graph
    assert ([n.node_id for n in graph.nodes], graph.map_version) == (["0", "1", "2"], 9)


def test_what_is_absent_stays_absent():
    whole = joined([clouds.CropCloudResponse(), clouds.CropCloudResponse(indices=b"ab")])
    assert not whole.HasField("cloud")
    bare = geometry_pb2.PointCloud(num_points=1, positions=b"x" * 12)
    whole = joined([clouds.CropCloudResponse(cloud=bare), clouds.CropCloudResponse(cloud=bare)])
    assert not whole.cloud.HasField("colours")
    assert geometry.cloud(whole.cloud).num_points == 2


def test_a_step_that_found_much_goes_on_in_further_results():
    call = kept.run_pipeline(b"file", [Step("crop_cloud"), Step("cluster_points")], False, False)
    parts = [pipelines.RunPipelineResponse() for _ in range(3)]
    first = parts[0].results.add()
    first.num_points_in, first.indices = 9, b"\1\0\0\0"
    for part, label in zip(parts[1:], (b"\0\0\0\0", b"\xff\xff\xff\xff"), strict=True):
        result = part.results.add()
        result.step, result.clusters.labels = 1, label
    parts[1].results[0].clusters.num_clusters = 1
    steps = call.read(joined(parts)).steps
    assert (steps[0].num_points_in, steps[0].answer.tolist()) == (9, [1])
    assert (steps[1].answer.labels.tolist(), steps[1].answer.num_clusters) == ([0, -1], 1)
