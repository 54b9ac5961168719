// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <map>
#include <system_error>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

namespace fs = std::filesystem;

}  // namespace

std::map<int, std::string> list_numbered(fs::path const& folder, std::string const& extension) {
  std::map<int, std::string> files;
  std::error_code failure;
  for (fs::directory_iterator it(folder, failure), end; !failure && it != end;
       it.increment(failure)) {
    fs::path const path = it->path();
    std::string const stem = path.stem().string();
    bool const wanted =
        extension.empty() ? has_image_extension(path) : path.extension() == extension;
    bool const numbered = !stem.empty() && stem.size() <= 10 &&
                          std::all_of(stem.begin(), stem.end(), [](char c) { return is_digit(c); });
    if (!numbered || !wanted) { continue; }
    std::int64_t const number = std::stoll(stem);
    if (number > 999'999'999) { continue; }
    auto const [place, added] = files.emplace(static_cast<int>(number), path.string());
    if (!added) { throw error(path.string() + ": same frame number as " + place->second); }
  }
  if (failure) { throw error(folder.string() + ": cannot be read: " + failure.message()); }
  return files;
}

namespace {

std::vector<std::int64_t> read_times(std::string const& path) {
  std::vector<std::int64_t> times;
  for (text_line const& line : read_lines(path)) {
    if (is_blank_or_comment(line.text)) { continue; }
    try {
      times.push_back(seconds_to_ns(line.text, path, line.number));
    } catch (error const& e) {
      throw error(std::string(e.what()) + "; accepted is a line for each image: seconds");
    }
  }
  return times;
}

bool is_raw(layout_of_files const& layout) { return layout.name == "kitti_raw"; }

std::string image_folder(layout_of_files const& layout, int side) {
  return (is_raw(layout) ? "image_0" : "image_") + std::to_string(layout.left_camera + side);
}

std::map<int, std::string> images_of(layout_of_files const& layout, int side) {
  fs::path folder = layout.root / image_folder(layout, side);
  if (is_raw(layout)) { folder /= "data"; }
  if (!is_directory(folder.string())) { refuse_pair(folder.string() + ": no such folder"); }
  std::map<int, std::string> images = list_numbered(folder, {});
  if (images.empty()) {
    throw error(folder.string() + ": no images (000000.png, .jpg or .jpeg, numbered)");
  }
  return images;
}

}  // namespace

void find_kitti_frames(layout_of_files& layout, open_options const& options) {
  if (options.rig == camera_kind::rgbd) { refuse_depths(layout); }
  bool const pair =
      is_pair(options.rig) || (options.rig == camera_kind::any &&
                               is_directory((layout.root / image_folder(layout, 1)).string()));
  layout.stamps_from = is_raw(layout) ? "timestamps.txt" : "times.txt";
  layout.second_folder = image_folder(layout, 1);
  layout.kind = pair ? camera_kind::stereo : camera_kind::mono;
  std::string const times_file =
      (is_raw(layout) ? layout.root / image_folder(layout, 0) / layout.stamps_from
                      : layout.root / layout.stamps_from)
          .string();
  if (!is_file(times_file)) {
    throw error(times_file +
                ": no such file; without times of the images, a rate (--fps) says them");
  }
  layout.times = is_raw(layout) ? read_dates(times_file) : read_times(times_file);
  std::map<int, std::string> const lefts = images_of(layout, 0);
  std::map<int, std::string> const rights = pair ? images_of(layout, 1) : lefts;
  std::vector<bool> kept(layout.times.size());
  for (std::size_t const i :
       ordered_lines(layout.times, disordered::left_out, times_file, "frames", layout.warnings)) {
    kept[i] = true;
  }
  std::size_t common = 0;
  for (auto const& [number, left] : lefts) {
    auto const right = rights.find(number);
    if (right == rights.end()) { continue; }
    ++common;
    auto const i = static_cast<std::size_t>(number);
    if (i >= layout.times.size()) {
      throw error(times_file + ": " + std::to_string(layout.times.size()) + " times, none for " +
                  left);
    }
    if (!kept[i]) { continue; }
    layout.frames.push_back({layout.times[i], left, pair ? right->second : std::string()});
  }
  if (layout.frames.empty()) {
    throw error(layout.root.string() + ": no stereo pair: " + image_folder(layout, 0) + " holds " +
                std::to_string(lefts.size()) + " images, " + image_folder(layout, 1) + " " +
                std::to_string(rights.size()) + ", none with equal numbers");
  }
  layout.unpaired.left = static_cast<int>(lefts.size() - common);
  layout.unpaired.right = static_cast<int>(rights.size() - common);
}

}  // namespace seq::detail
