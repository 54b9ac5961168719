// SPDX-License-Identifier: Apache-2.0
// 7-Scenes: frame-000000.color.png, .depth.png and .pose.txt of each frame in one folder
// (https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/).
#include <map>
#include <system_error>
#include <tuple>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

namespace fs = std::filesystem;

/// The files of a frame; empty where one is not there.
struct scene_files {
  std::string colour;
  std::string depth;
  std::string pose;
};

/// The number in "frame-000012.color.png" before `kind`, here ".color"; below 0 for another name.
std::int64_t number_before(std::string const& stem, std::string const& kind) {
  if (stem.size() <= kind.size() ||
      stem.compare(stem.size() - kind.size(), kind.size(), kind) != 0) {
    return -1;
  }
  std::size_t const end = stem.size() - kind.size();
  std::size_t begin = end;
  while (begin > 0 && is_digit(stem[begin - 1])) { --begin; }
  return begin < end && end - begin <= 9 ? std::stoll(stem.substr(begin, end - begin)) : -1;
}

/// @throws seq::error for two files of one kind and number
std::map<std::int64_t, scene_files> list_frames(fs::path const& folder) {
  std::map<std::int64_t, scene_files> frames;
  std::error_code failure;
  for (fs::directory_iterator it(folder, failure), end; !failure && it != end;
       it.increment(failure)) {
    fs::path const& path = it->path();
    std::string const stem = path.stem().string();
    bool const image = has_image_extension(path);
    bool const text = path.extension() == ".txt";
    for (auto const& [kind, wanted, file] : {std::tuple{".color", image, &scene_files::colour},
                                             std::tuple{".depth", image, &scene_files::depth},
                                             std::tuple{".pose", text, &scene_files::pose}}) {
      std::int64_t const number = wanted ? number_before(stem, kind) : -1;
      if (number < 0) { continue; }
      std::string& place = frames[number].*file;
      if (!place.empty()) { throw error(path.string() + ": same frame number as " + place); }
      place = path.string();
    }
  }
  return frames;
}

}  // namespace

bool has_scene_frames(fs::path const& root) {
  std::error_code failure;
  for (fs::directory_iterator it(root, failure), end; !failure && it != end;
       it.increment(failure)) {
    if (has_image_extension(it->path()) &&
        number_before(it->path().stem().string(), ".color") >= 0) {
      return true;
    }
  }
  return false;
}

void find_scene_frames(layout_of_files& layout, open_options const& options) {
  if (is_pair(options.rig)) {
    throw error(layout.root.string() + ": the layout " + title_of(layout.name) +
                " has no second camera");
  }
  constexpr double usual_rate = 30;  // of the Kinect that has recorded them
  double const rate = options.fps > 0 ? options.fps : usual_rate;
  std::map<std::int64_t, scene_files> const found = list_frames(layout.root);
  bool depth = false;
  for (auto const& [number, files] : found) { depth = depth || !files.depth.empty(); }
  if (options.rig == camera_kind::rgbd && !depth) { refuse_depths(layout); }
  layout.kind = depth && options.rig != camera_kind::mono ? camera_kind::rgbd : camera_kind::mono;
  layout.rate = rate;
  layout.depth_unit = 1e-3;
  layout.no_depth = 65535;
  layout.stamps_from = to_text(rate) + " images a second, " +
                       (options.fps > 0 ? "as asked for" : "as 7-Scenes was recorded");
  for (auto const& [number, files] : found) {
    std::int64_t const time = time_of_frame(static_cast<double>(number - found.begin()->first),
                                            rate, layout.root.string());
    if (!files.pose.empty()) { layout.poses.push_back({time, files.pose}); }
    bool const complete = layout.kind == camera_kind::mono || !files.depth.empty();
    if (!files.colour.empty() && complete) {
      layout.frames.push_back(
          {time, files.colour, layout.kind == camera_kind::mono ? std::string() : files.depth});
    } else {
      layout.unpaired.left += static_cast<int>(!files.colour.empty());
      layout.unpaired.right +=
          static_cast<int>(layout.kind == camera_kind::rgbd && !files.depth.empty());
    }
  }
  if (layout.frames.empty()) {
    throw error(layout.root.string() +
                ": no frame with both frame-000000.color.png and frame-000000.depth.png of one "
                "number");
  }
  if (options.fps == 0) {
    layout.warnings.push_back(layout.root.string() +
                              ": nothing says the times of the images: " + to_text(usual_rate) +
                              " images a second are assumed, as 7-Scenes was recorded; --fps "
                              "(fps) says another rate");
  }
}

}  // namespace seq::detail
