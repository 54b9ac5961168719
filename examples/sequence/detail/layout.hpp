// SPDX-License-Identifier: Apache-2.0
/// @file The files of a recording, by the layout of its folder. Not API.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/reader.hpp"

namespace seq::detail {

/// The images of a frame on disk.
struct frame_files {
  std::int64_t time_ns = 0;
  std::string left;
  std::string second;                  ///< the right image or the depth image; empty for one camera
  std::vector<std::string> more = {};  ///< of the cameras beside the pair; empty = none was taken
  std::vector<std::string> depths = {};  ///< of stereo_rig::depth_cameras, likewise
};

/// A line of a list of images.
struct listed_image {
  std::int64_t time_ns = 0;
  std::string file;  ///< where it is; empty where there is no such file
};

/// The images of a camera beside the pair, or the depth images of any camera, sorted by time.
struct camera_images {
  std::string name;  ///< such as cam2, depth2
  std::vector<listed_image> images;
  int camera = 0;  ///< number of the camera whose depths they are
};

struct layout_of_files {
  std::string name;  ///< that of sequence::layout()
  std::filesystem::path root;
  std::filesystem::path mav0;  ///< EuRoC only
  int left_camera = 0;         ///< number of KITTI's left camera
  camera_kind kind = camera_kind::stereo;
  std::vector<std::int64_t> times;    ///< of all frames, for poses.txt
  std::vector<frame_files> frames;    ///< sorted by time
  std::vector<camera_images> more;    ///< cameras beside the pair, cam2 ...
  std::vector<camera_images> depths;  ///< of a mixed rig, depth0 ...
  unpaired_images unpaired;
  std::string stamps_from;     ///< for people: which file, or the names
  std::string second_folder;   ///< for people: where images of a second camera would be
  bool of_tum = false;         ///< of the TUM RGB-D benchmark itself, or of ICL-NUIM
  int freiburg = 0;            ///< number of that benchmark's camera; 0 = none
  double rate = 0;             ///< images a second, where frames are counted; 0 = they have times
  std::string y_up_truth;      ///< ICL-NUIM: the file with its poses; empty = none
  double depth_unit = 0;       ///< metres, that all recordings of the layout have; 0 = none
  std::uint16_t no_depth = 0;  ///< a depth that means none, beside 0
  std::vector<listed_image> poses;  ///< files of the frames' poses, camera to world
  std::vector<std::string> warnings;
};

/// How far the stamps of two images of a frame may be apart where nobody says it, ns.
constexpr std::int64_t most_between_cameras_ns = 1'000'000;
constexpr std::int64_t most_to_depth_ns = 20'000'000;

/// Recognises the layout and lists the frames. @throws seq::error
layout_of_files find_layout(std::string const& directory, open_options const& options);

/// The name of a layout, for people.
char const* title_of(std::string const& layout);

// Its parts: they fill kind, times, frames, unpaired and warnings of a layout whose root is known.

/// Depth images were asked for, and there are none. @throws seq::error that says what is accepted
[[noreturn]] void refuse_depths(layout_of_files const& layout);
/// A pair was asked for, and there is one camera. @throws seq::error @param what is missing
[[noreturn]] void refuse_pair(std::string const& what);
void find_euroc_frames(layout_of_files& layout, open_options const& options);
void find_kitti_frames(layout_of_files& layout, open_options const& options);
void find_tum_frames(layout_of_files& layout, open_options const& options);
/// @pre has_scene_frames(layout.root)
void find_scene_frames(layout_of_files& layout, open_options const& options);
/// Whether there are images named as those of 7-Scenes, frame-000000.color.png.
bool has_scene_frames(std::filesystem::path const& root);
/// number -> file, of a folder of files whose names are numbers; others are ignored.
/// @param extension of the files; empty = those of images @throws seq::error for a number twice
std::map<int, std::string> list_numbered(std::filesystem::path const& folder,
                                         std::string const& extension);
/// KITTI raw: the dates in a timestamps.txt. @throws seq::error
std::vector<std::int64_t> read_dates(std::string const& path);
/// KITTI raw: poses of the IMU in a world whose x is east, y north, z up, and whose origin is the
/// first one, of its folder oxts. @throws seq::error
trajectory read_oxts(std::filesystem::path const& folder, std::vector<std::string>& warnings);
/// Of plain folders: left and right (or cam0 and cam1, image_0 and image_1 ...), or one of images.
/// @pre has_image_folders(layout.root)
void find_folder_frames(layout_of_files& layout, open_options const& options);
bool has_image_folders(std::filesystem::path const& root);

struct camera_folders {
  std::filesystem::path left, right;        ///< right is empty for one camera
  std::string right_name = {};              ///< of the folder, also where it is not there
  std::vector<std::filesystem::path> more;  ///< of cam0, cam1: cam2 ...
  std::vector<std::pair<int, std::filesystem::path>> depths =
      {};                       ///< depth0 ..., by the camera's number
  std::string other_pair = {};  ///< a second pair, of whose folders one is named so
  std::string same_name = {};   ///< two of them whose names differ in case alone, for people
};

camera_folders find_camera_folders(std::filesystem::path const& root);
/// `folder`, or its `data`, whichever has images; empty if neither has.
std::filesystem::path with_images(std::filesystem::path const& folder);

/// `folder`/`name`, or the same stem with another image extension; empty if neither exists.
std::string find_image(std::filesystem::path const& folder, std::string const& name);
/// Whether a file's name ends as that of an image.
bool has_image_extension(std::filesystem::path const& file);

/// Two lists of images, each sorted by time.
struct two_lists {
  std::vector<listed_image> left, second;
  std::string left_name, second_name;  ///< for messages
};

/// Pairs the images of two lists by the nearest time. @throws seq::error without any pair
void pair_frames(two_lists const& lists, std::int64_t most_ns, layout_of_files& layout);

/// Adds the images of the cameras beside the pair, and depth images, to the frames: those that are
/// nearest to the left one within the limit, none where there is none. A camera without images, or
/// without a calibration, leaves the rig, and those after it. @throws seq::error without any frame
void add_cameras(calibration& calib, open_options const& options, layout_of_files& layout);

/// The frames of one camera: the images whose files are there. @param path of the list
/// @throws seq::error without any
void take_images(std::vector<listed_image> const& images, std::string const& path,
                 layout_of_files& layout);

/// Poses in the file's frame.
struct raw_ground_truth {
  enum frame { body, raw_left, kitti_reference };
  trajectory poses;
  frame of = raw_left;
  bool orientation = false;
  bool y_up = false;  ///< y of the camera, and of its world, points up
};

/// The ground truth that lies in the folder, sorted by time. @throws seq::error
raw_ground_truth find_ground_truth(layout_of_files const& layout,
                                   std::vector<std::string>& warnings);

/// The calibration that was named, or else the sequence's own, compared with the first images.
/// @throws seq::error; missing_calibration
calibration find_calibration(layout_of_files const& layout, open_options const& options,
                             recording_source& source);

/// Says in `files` where the calibration has a second camera, and no images of it were found.
void check_second_camera(layout_of_files& files, open_options const& options,
                         calibration const& calib);

/// Nothing, with the reason in `source`, unless there are samples, noise and place of an IMU. Where
/// there are samples, `warnings` has the reason, too.
/// @param T_body_left of loaded frames @throws seq::error
std::optional<imu_recording> find_imu(layout_of_files const& layout, calibration const& calib,
                                      Eigen::Isometry3d const& T_body_left,
                                      recording_source& source, std::vector<std::string>& warnings);

std::string size_text(int width, int height);
/// @throws seq::error with both sizes
void check_image_size(std::string const& path, int width, int height,
                      camera_intrinsics const& camera);

/// Says in `warnings` where the rate is not the calibration's, or the units are unlikely: a median
/// specific force that is not near gravity, a median angular rate above 3 rad/s.
void check_imu(imu_recording const& imu, std::string const& path,
               std::vector<std::string>& warnings);

}  // namespace seq::detail
