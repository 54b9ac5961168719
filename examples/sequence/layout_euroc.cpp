// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/table.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

namespace fs = std::filesystem;

/// The images of an EuRoC camera's data.csv.
std::vector<listed_image> read_image_list(fs::path const& camera,
                                          std::vector<std::string>& warnings) {
  std::string const path = (camera / "data.csv").string();
  if (!is_file(path)) {
    throw error(path + ": no such file; accepted is a line for each image: time stamp [ns], file");
  }
  stamp_column stamps(path, finest_frame_step_ns);
  std::vector<std::string> names;
  for (table_row const& row : read_table(path, 2, "time stamp, file", warnings).rows) {
    stamps.add(row.fields[0], row.line);
    names.push_back(row.fields[1]);
    if (names.back().empty()) { fail_at(path, row.line, "no file name"); }
  }
  if (names.empty()) { throw error(path + ": lists no images"); }
  std::vector<std::int64_t> const times = stamps.times_ns(warnings);
  std::vector<listed_image> images;
  for (std::size_t const i : ordered_lines(times, disordered::sorted, path, "images", warnings)) {
    images.push_back({times[i], find_image(camera / "data", names[i])});
  }
  return images;
}

}  // namespace

void find_euroc_frames(layout_of_files& layout, open_options const& options) {
  auto const camera = [&](char const* name) { return layout.mav0 / name; };
  if (!is_directory(camera("cam0").string())) {
    throw error(camera("cam0").string() +
                ": no such folder; accepted are cam0 alone, and cam0 with cam1, ...");
  }
  if (options.rig == camera_kind::rgbd) { refuse_depths(layout); }
  bool const pair = is_pair(options.rig) ||
                    (options.rig == camera_kind::any && is_directory(camera("cam1").string()));
  layout.stamps_from = "data.csv";
  layout.second_folder = camera("cam1").string();
  layout.kind = pair ? camera_kind::stereo : camera_kind::mono;
  if (pair) {
    if (!is_directory(camera("cam1").string())) {
      refuse_pair(camera("cam1").string() + ": no such folder");
    }
    two_lists lists;
    lists.left = read_image_list(camera("cam0"), layout.warnings);
    lists.second = read_image_list(camera("cam1"), layout.warnings);
    lists.left_name = "cam0";
    lists.second_name = "cam1";
    pair_frames(lists, options.max_time_difference_ns.value_or(most_between_cameras_ns), layout);
    for (int k = 2; options.rig == camera_kind::mixed; ++k) {
      std::string const name = "cam" + std::to_string(k);
      fs::path const folder = camera(name.c_str());
      if (!is_file((folder / "data.csv").string())) { break; }
      layout.more.push_back({name, read_image_list(folder, layout.warnings)});
    }
    for (int k = 0;
         options.rig == camera_kind::mixed && k < 2 + static_cast<int>(layout.more.size()); ++k) {
      std::string const name = "depth" + std::to_string(k);
      fs::path const folder = camera(name.c_str());
      if (!is_file((folder / "data.csv").string())) { continue; }
      layout.depths.push_back({name, read_image_list(folder, layout.warnings), k});
    }
    return;
  }
  take_images(read_image_list(camera("cam0"), layout.warnings),
              (camera("cam0") / "data.csv").string(), layout);
}

}  // namespace seq::detail
