"""From pictures to features and matches: what a source is, which frames to measure in, what they share."""

from panopath.frontend.features import FeatureOptions, Features, extract_features
from panopath.frontend.fixed import FixedContent, FixedOptions, find_fixed, without_fixed
from panopath.frontend.images import ImageHeader, image_files, read_header, read_image
from panopath.frontend.matching import ImageMatches, MatchingOptions, candidate_pairs, match_images
from panopath.frontend.pictures import FrontEndOptions, Measured, Picture, check_masks, measure
from panopath.frontend.sources import Source, SourceKind, recognise
from panopath.frontend.video import (
    VideoFrame,
    VideoHeader,
    VideoKind,
    VideoMotion,
    VideoOptions,
    choose_keyframes,
    read_frames,
    video_motion,
)
from panopath.frontend.whole import why_not_whole

__all__ = [
    "FeatureOptions",
    "Features",
    "FixedContent",
    "FixedOptions",
    "FrontEndOptions",
    "ImageHeader",
    "ImageMatches",
    "MatchingOptions",
    "Measured",
    "Picture",
    "Source",
    "SourceKind",
    "VideoFrame",
    "VideoHeader",
    "VideoKind",
    "VideoMotion",
    "VideoOptions",
    "candidate_pairs",
    "check_masks",
    "choose_keyframes",
    "extract_features",
    "find_fixed",
    "image_files",
    "match_images",
    "measure",
    "read_frames",
    "read_header",
    "read_image",
    "recognise",
    "video_motion",
    "why_not_whole",
    "without_fixed",
]
