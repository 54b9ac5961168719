// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cctype>
#include <cmath>
#include <iterator>
#include <system_error>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

namespace fs = std::filesystem;

constexpr char const* image_extensions[] = {".png", ".jpg", ".jpeg", ".pgm",
                                            ".ppm", ".bmp", ".tiff", ".tif"};

std::vector<std::int64_t> times_of(std::vector<listed_image> const& list) {
  std::vector<std::int64_t> times;
  for (listed_image const& image : list) { times.push_back(image.time_ns); }
  return times;
}

/// The images whose files are there.
std::vector<listed_image> present(std::vector<listed_image> list) {
  list.erase(std::remove_if(list.begin(), list.end(),
                            [](listed_image const& image) { return image.file.empty(); }),
             list.end());
  return list;
}

/// Of the images of a folder, or of its folders, the first that is of a kind that is not read.
std::string unread_images(fs::path const& folder) {
  constexpr char const* kinds[] = {".webp", ".heic", ".heif", ".avif", ".gif", ".jp2", ".exr"};
  std::error_code failure;
  fs::recursive_directory_iterator it(folder, failure), end;
  for (int seen = 0; !failure && it != end && seen < 1000; it.increment(failure), ++seen) {
    if (it.depth() > 1) { it.disable_recursion_pending(); }
    std::string const extension = it->path().extension().string();
    for (char const* kind : kinds) {
      if (extension == kind) {
        return ": images of the kind " + extension + " are not read, those of " +
               "png, jpg, pgm, ppm, bmp and tiff are";
      }
    }
  }
  return "";
}

}  // namespace

std::string find_image(fs::path const& folder, std::string const& name) {
  fs::path const listed = folder / name;
  if (is_file(listed.string())) { return listed.string(); }
  for (char const* extension : image_extensions) {
    std::string const other = fs::path(listed).replace_extension(extension).string();
    if (is_file(other)) { return other; }
  }
  return {};
}

bool has_image_extension(fs::path const& file) {
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return std::find(std::begin(image_extensions), std::end(image_extensions), extension) !=
         std::end(image_extensions);
}

namespace {

/// Says where the steps of two lists differ by a factor that only units have.
std::string other_units(two_lists const& lists, std::vector<std::int64_t> const& left,
                        std::vector<std::int64_t> const& second) {
  auto const a = static_cast<double>(median_step(left));
  auto const b = static_cast<double>(median_step(second));
  constexpr double factor = 300;
  if (a == 0 || b == 0 || (a < factor * b && b < factor * a)) { return {}; }
  return "; images are " + to_text(1e-9 * a) + " s apart by " + lists.left_name + " and " +
         to_text(1e-9 * b) + " s by " + lists.second_name + ": are both in one unit?";
}

void say_missing(std::string const& list, std::size_t missing, std::vector<std::string>& warnings) {
  if (missing == 0) { return; }
  warnings.push_back(list + ": " + std::to_string(missing) + " of the listed images are not there");
}

}  // namespace

void pair_frames(two_lists const& lists, std::int64_t most_ns, layout_of_files& layout) {
  std::vector<listed_image> const left = present(lists.left);
  std::vector<listed_image> const second = present(lists.second);
  std::vector<std::int64_t> const left_times = times_of(left);
  std::vector<std::int64_t> const second_times = times_of(second);
  std::vector<double> apart;
  for (auto const& [i, k] : nearest_pairs(left_times, second_times, most_ns)) {
    layout.frames.push_back({left_times[i], left[i].file, second[k].file});
    apart.push_back(static_cast<double>(second_times[k] - left_times[i]));
  }
  if (layout.frames.empty()) {
    auto const count = [](std::string const& name, std::size_t listed, std::size_t there) {
      return name + " lists " + std::to_string(listed) + " images, " + std::to_string(there) +
             " of them there";
    };
    std::string reason =
        "no pair of images: " + count(lists.left_name, lists.left.size(), left.size()) + "; " +
        count(lists.second_name, lists.second.size(), second.size());
    if (!left.empty() && !second.empty()) {
      reason += "; the nearest time stamps are " +
                milliseconds(smallest_distance(left_times, second_times)) + " ms apart, at most " +
                milliseconds(most_ns) + " ms allowed" +
                other_units(lists, left_times, second_times);
    }
    throw error(layout.root.string() + ": " + reason);
  }
  say_missing(lists.left_name, lists.left.size() - left.size(), layout.warnings);
  say_missing(lists.second_name, lists.second.size() - second.size(), layout.warnings);
  layout.unpaired.left = static_cast<int>(left.size() - layout.frames.size());
  layout.unpaired.right = static_cast<int>(second.size() - layout.frames.size());
  double const offset = median(apart);
  auto const farthest = std::max_element(
      apart.begin(), apart.end(), [](double a, double b) { return std::fabs(a) < std::fabs(b); });
  if (layout.kind == camera_kind::stereo && *farthest != 0) {
    layout.warnings.push_back("the cameras' time stamps differ: " + lists.second_name + " is " +
                              to_text(1e-6 * offset) + " ms after " + lists.left_name +
                              " in the median, at most " + to_text(1e-6 * std::fabs(*farthest)) +
                              " ms apart; pairs are the nearest within " + milliseconds(most_ns) +
                              " ms");
  }
}

namespace {

/// For each frame the image that is nearest to its time; empty where none is within the limit.
std::vector<std::string> at_frames(camera_images const& camera, std::int64_t most_ns,
                                   char const* without, layout_of_files& layout) {
  std::vector<listed_image> const there = present(camera.images);
  std::vector<std::int64_t> times;
  for (frame_files const& frame : layout.frames) { times.push_back(frame.time_ns); }
  auto const pairs = nearest_pairs(times, times_of(there), most_ns);
  if (pairs.empty()) {
    throw error(layout.root.string() + ": " + camera.name +
                " has no image of the time of a pair, within " + milliseconds(most_ns) + " ms");
  }
  std::vector<std::string> files(times.size());
  for (auto const& [i, k] : pairs) { files[i] = there[k].file; }
  if (pairs.size() < times.size()) {
    layout.warnings.push_back(std::to_string(times.size() - pairs.size()) + " of " +
                              std::to_string(times.size()) + " frames have no image of " +
                              camera.name + " within " + milliseconds(most_ns) + " ms: " + without);
  }
  return files;
}

void add_depths(stereo_rig& rig, open_options const& options, layout_of_files& layout) {
  for (camera_images const& depth : layout.depths) {
    if (depth.camera >= 2 + static_cast<int>(rig.more.size())) {
      layout.warnings.push_back(depth.name + " is not taken: its camera, cam" +
                                std::to_string(depth.camera) + ", is not");
      continue;
    }
    std::vector<std::string> const files =
        at_frames(depth, options.max_time_difference_ns.value_or(most_to_depth_ns),
                  "its camera has no depths in them", layout);
    for (std::size_t i = 0; i < files.size(); ++i) { layout.frames[i].depths.push_back(files[i]); }
    rig.depth_cameras.push_back(depth.camera);
  }
}

}  // namespace

void add_cameras(calibration& calib, open_options const& options, layout_of_files& layout) {
  std::vector<mounted_camera>& more = calib.rig.more;
  std::size_t const count = std::min(more.size(), layout.more.size());
  std::size_t const most = std::max(more.size(), layout.more.size());
  if (count < most) {
    layout.warnings.push_back(
        "cam" + std::to_string(2 + count) + (count + 1 < most ? " and those after it are" : " is") +
        " not taken: it has no " + (count < more.size() ? "images" : "calibration"));
  }
  more.resize(count);
  for (std::size_t k = 0; k < count; ++k) {
    std::vector<std::string> const files =
        at_frames(layout.more[k], options.max_time_difference_ns.value_or(most_between_cameras_ns),
                  "it misses them, and the others are tracked", layout);
    for (std::size_t i = 0; i < files.size(); ++i) { layout.frames[i].more.push_back(files[i]); }
  }
  add_depths(calib.rig, options, layout);
}

void take_images(std::vector<listed_image> const& images, std::string const& path,
                 layout_of_files& layout) {
  for (listed_image const& image : images) {
    if (!image.file.empty()) { layout.frames.push_back({image.time_ns, image.file, {}}); }
  }
  std::size_t const missing = images.size() - layout.frames.size();
  if (layout.frames.empty()) {
    throw error(path + ": none of the " + std::to_string(missing) + " listed images is there");
  }
  say_missing(path, missing, layout.warnings);
}

namespace {

constexpr char const* accepted_folders =
    "folders with mav0/cam0 or cam0/data.csv (EuRoC), image_0 or image_2 (KITTI), image_00/data or "
    "image_02/data (KITTI raw), rgb.txt or "
    "associations.txt (TUM RGB-D), color.txt with aligned_depth.txt (OpenLORIS), "
    "frame-000000.color.png with frame-000000.depth.png (7-Scenes), "
    "or images (left and right, cam0 and cam1, or in the folder itself)";
constexpr char const* bags_and_videos =
    "; bags (.bag, .db3, .mcap) and videos are read by python -m ft track";

}  // namespace

void refuse_depths(layout_of_files const& layout) {
  throw error(layout.root.string() +
              ": no depth images; accepted are rgb.txt with depth.txt, or associations.txt (TUM "
              "RGB-D), color.txt with aligned_depth.txt (OpenLORIS), frame-000000.color.png with "
              "frame-000000.depth.png (7-Scenes), and with "
              "--rig mixed (rig=\"mixed\") depth0 beside cam0, depth1 ...");
}

void refuse_pair(std::string const& what) {
  throw error(what + ": not a stereo sequence; --rig mono (rig=\"mono\") takes one camera");
}

char const* title_of(std::string const& layout) {
  return layout == "euroc"       ? "EuRoC (ASL)"
         : layout == "kitti"     ? "KITTI odometry"
         : layout == "kitti_raw" ? "KITTI raw"
         : layout == "tum"       ? "TUM RGB-D"
         : layout == "openloris" ? "OpenLORIS"
         : layout == "7scenes"   ? "7-Scenes"
                                 : "folders of images";
}

namespace {

/// Empty where none is recognised. Sets `mav0`, and a root that is its parent. @param given whether
/// the times of the images are
std::string name_of(layout_of_files& l, bool given) {
  auto const has = [&](char const* name) { return is_directory((l.root / name).string()); };
  auto const has_file = [&](char const* name) { return is_file((l.root / name).string()); };
  bool const asl = has("mav0") || has_file("cam0/data.csv");
  bool const plain = !asl && has_image_folders(l.root);
  if (has("mav0")) {
    l.mav0 = l.root / "mav0";
    return "euroc";
  }
  if (has("cam0") && !plain) {
    l.mav0 = l.root;
    l.root = l.root.parent_path();
    return "euroc";
  }
  if ((has("image_0") || has("image_2")) && (has_file("times.txt") || !given)) { return "kitti"; }
  bool const dates = has_file("image_00/timestamps.txt") || has_file("image_02/timestamps.txt");
  if (dates && !given) { return "kitti_raw"; }
  if (has_file("rgb.txt") || has_file("associations.txt")) { return "tum"; }
  if (has_file("color.txt") && has_file("aligned_depth.txt")) { return "openloris"; }
  if (has_scene_frames(l.root)) { return "7scenes"; }
  return plain ? "folders" : "";
}

void find_frames(layout_of_files& l, open_options const& options) {
  auto const has = [&](char const* name) { return is_directory((l.root / name).string()); };
  bool const colour = has("image_2") || has("image_02");  // of KITTI
  l.left_camera = colour && !has("image_0") && !has("image_00") ? 2 : 0;
  if (l.name == "euroc") {
    find_euroc_frames(l, options);
  } else if (l.name == "kitti" || l.name == "kitti_raw") {
    find_kitti_frames(l, options);
  } else if (l.name == "tum" || l.name == "openloris") {
    find_tum_frames(l, options);
  } else if (l.name == "7scenes") {
    find_scene_frames(l, options);
  } else {
    find_folder_frames(l, options);
  }
}

}  // namespace

layout_of_files find_layout(std::string const& directory, open_options const& options) {
  std::string const accepted = std::string(accepted_folders) + bags_and_videos;
  if (!is_directory(directory)) {
    throw error(
        directory +
        (is_file(directory) ? ": a file; accepted are " : ": no such folder; accepted are ") +
        accepted);
  }
  layout_of_files l;
  std::error_code failure;
  l.root = fs::canonical(directory, failure);
  if (failure) { throw error(directory + ": cannot be read: " + failure.message()); }
  bool const given = options.fps > 0 || !options.times.empty();
  l.name = name_of(l, given);
  if (l.name.empty()) {
    throw error(directory + ": no sequence found" + unread_images(l.root) + "; accepted are " +
                accepted);
  }
  find_frames(l, options);
  bool const rate = l.rate > 0 && options.fps > 0;
  if (given && l.name != "folders" && !rate) {
    throw error(directory + ": " + (options.fps > 0 ? "fps" : "times") +
                ": the images of the layout " + l.name + " have times of their own");
  }
  if (l.times.empty()) {
    for (frame_files const& frame : l.frames) { l.times.push_back(frame.time_ns); }
  }
  return l;
}

}  // namespace seq::detail
