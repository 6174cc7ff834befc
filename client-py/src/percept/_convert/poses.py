"""Pose estimates, and what became of frames."""

from __future__ import annotations

from ..types.poses import (
    FrameResult,
    LostReason,
    PoseAt,
    PoseEstimate,
    Scale,
    ScaleSource,
    TrackingState,
    Transform,
    WaitingFor,
)
from ..types.sensors import FrameAck, Rejection
from ..v1 import error_pb2, session_pb2
from . import geometry, words


def pose_estimate(message: session_pb2.PoseEstimate) -> PoseEstimate:
    """A pose estimate."""
    return PoseEstimate(
        stamp_ns=message.stamp_ns,
        state=words.word(TrackingState, session_pb2.TrackingState, message.state),
        t_map_base=geometry.pose(message.t_map_base),
        covariance=geometry.covariance(message.covariance),
        t_odom_base=geometry.pose(message.t_odom_base),
        lost_reason=words.word(LostReason, session_pb2.LostReason, message.lost_reason),
        lost_message=message.lost_message,
        inlier_ratio=message.inlier_ratio,
        rmse_m=message.rmse_m,
        degenerate_axes=tuple(message.degenerate_axes),
        map_version=message.map_version,
        scale=words.word(Scale, session_pb2.Scale, message.scale),
        scale_source=words.word(ScaleSource, session_pb2.ScaleSource, message.scale_source),
        scale_message=message.scale_message,
        waiting_for=words.word(WaitingFor, session_pb2.WaitingFor, message.waiting_for),
        waiting_message=message.waiting_message,
        relocalised=message.relocalised,
        tentative=message.tentative,
        led_by=message.led_by or None,
    )


def pose_at(message: session_pb2.PoseAt) -> PoseAt:
    """A pose at a time."""
    return PoseAt(
        stamp_ns=message.stamp_ns,
        t_map_base=geometry.pose(message.t_map_base),
        t_odom_base=geometry.pose(message.t_odom_base) if message.HasField("t_odom_base") else None,
        state=words.word(TrackingState, session_pb2.TrackingState, message.state),
        scale=words.word(Scale, session_pb2.Scale, message.scale),
        before_ns=message.before_ns,
        after_ns=message.after_ns,
        map_version=message.map_version,
    )


def transform(message: session_pb2.Transform) -> Transform:
    """A transform."""
    return Transform(
        target_frame=message.target_frame,
        source_frame=message.source_frame,
        t_target_source=geometry.pose(message.t_target_source),
        stamp_ns=message.stamp_ns if message.HasField("stamp_ns") else None,
        state=words.word(TrackingState, session_pb2.TrackingState, message.state),
        scale=words.word(Scale, session_pb2.Scale, message.scale),
        map_version=message.map_version,
    )


def result(message: session_pb2.FrameResult) -> FrameResult:
    """What an accepted frame did."""
    return FrameResult(
        pose=pose_estimate(message.pose) if message.HasField("pose") else None,
        keyframe_id=message.keyframe_id if message.HasField("keyframe_id") else None,
        latency_s=message.latency_s,
        duplicate=message.duplicate,
    )


def rejection(message: error_pb2.ErrorInfo) -> Rejection:
    """Why a frame was refused."""
    return Rejection(reason=message.reason, message=message.message, field=message.field, code=message.code)


def ack(message: session_pb2.FrameAck) -> FrameAck:
    """What became of a frame."""
    return FrameAck(
        sensor_id=message.sensor_id,
        sequence=message.sequence,
        stamp_ns=message.stamp_ns,
        result=result(message.result) if message.HasField("result") else None,
        rejection=rejection(message.rejection) if message.HasField("rejection") else None,
        durable_count=message.durable_count,
    )
