// SPDX-License-Identifier: Apache-2.0
/// @file The map of a camera as a file.
///
/// Version 3, little-endian, without padding:
/// - 16 bytes "ft odometry map" and 0; uint32 version; uint32 0x01020304;
/// - uint64 bytes of the text, uint64 bytes of the arrays;
/// - the text of map_origin: rig, image size, settings and capacities;
/// - the arrays in the order of each_array(), of one camera pair, what is not in use cleared;
/// - uint64 FNV-1a hash of all bytes before it (Fowler, Noll, Vo);
/// - where the text ends with the line "loops: kept", what loop_files.hpp says.
///
/// A file fits an odometry with the same text, but for that line: an odometry with loops also takes
/// a map without them. Version 1 had capacities alone, version 2 no keypoints that are aligned.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <istream>
#include <memory>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "ft/containers/odometry_map.hpp"
#include "ft/core/config.hpp"
#include "ft/core/detail/read_stream.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/pipelines/detail/map_checks.hpp"
#include "ft/pipelines/detail/map_origin.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Calls visit(data, count) for every array of batch entry b that a file has: not for the frames in
/// which points were found, which are numbers of a run. An array more in a view makes another
/// version.
template <typename Visit>
void each_array(odometry_map_view const& map, int b, Visit const& visit) {
  odometry_map_view entry = skip_entries(map, b);
  int const* const left_out[] = {entry.points.count, entry.records.found_frame};
  each_column(entry, [&](auto* array, extent const& e) {
    void const* const data = array;
    if (data != left_out[0] && data != left_out[1]) { visit(array, e.each); }
  });
}

/// Bytes of the arrays of a batch entry.
inline std::uint64_t array_bytes_of(odometry_map_view const& map) {
  std::uint64_t sum = 0;
  each_array(map, 0, [&](auto* data, std::size_t n) { sum += n * sizeof *data; });
  return sum;
}

inline constexpr std::uint64_t fnv1a_start = 0xcbf29ce484222325u;
inline std::uint64_t fnv1a(void const* data, std::size_t bytes, std::uint64_t hash) {
  auto const* const from = static_cast<unsigned char const*>(data);
  for (std::size_t i = 0; i < bytes; ++i) { hash = (hash ^ from[i]) * 0x100000001b3u; }
  return hash;
}

struct map_file_head {
  char magic[16] = "ft odometry map";
  std::uint32_t version = 3;
  std::uint32_t order = 0x01020304;
  std::uint64_t text_bytes = 0, array_bytes = 0;
};
static_assert(sizeof(map_file_head) == 40, "without padding");
inline constexpr std::size_t version_end = 24;  ///< bytes up to what each version has

/// Batch entry b of a map, in memory of the host.
template <memory_space Space>
class host_map {
public:
  explicit host_map(odometry_map_view const& of)
      : memory_([&](carver& c) {
          carve(c, view_,
                {of.records.slots,
                 {of.keyframes.positions, of.keyframes.cameras, of.keyframes.capacity}},
                1);
        }) {}
  odometry_map_view const& view() const { return view_; }
  template <typename Exec>
  void download(Exec const& exec, odometry_map_view const& map, int b) const {
    copy_all(exec, map, b, view_, 0);
  }
  template <typename Exec>
  void upload(Exec const& exec, odometry_map_view const& map, int b) const {
    copy_all(exec, view_, 0, map, b);
  }

private:
  template <typename Exec>
  static void copy_all(Exec const& exec, odometry_map_view const& from, int of,
                       odometry_map_view const& to, int b) {
    std::vector<void const*> arrays;
    each_array(from, of, [&](auto* data, std::size_t) { arrays.push_back(data); });
    std::size_t next = 0;
    each_array(to, b, [&](auto* data, std::size_t n) {
      copy_bytes(exec, data, arrays[next++], n * sizeof *data);
    });
    exec.wait();
  }

  odometry_map_view view_;  // the memory's constructor writes it
  arena<Space> memory_;
};

/// The last line of the text of a file that has loops.
inline constexpr char loops_line[] = "loops: kept\n";

/// A copy of batch entry b of a map, to be written at any time, without the odometry. Waits, and
/// allocates. @param loops whether they follow @throws std::bad_alloc, cuda_error
template <typename Exec>
map_snapshot::writer odometry_map_writer(Exec const& exec, odometry_map_view const& map, int b,
                                         map_origin const& origin, bool loops) {
  auto const host = std::make_shared<host_map<memory_space::host>>(map);
  host->download(exec, map, b);
  clear_unused(host->view());
  return [host, text = origin.text() + (loops ? loops_line : "")](std::ostream& to) {
    std::uint64_t hash = fnv1a_start;
    auto const put = [&](void const* data, std::size_t bytes) {
      hash = fnv1a(data, bytes, hash);
      to.write(static_cast<char const*>(data), static_cast<std::streamsize>(bytes));
    };
    map_file_head head;
    head.text_bytes = text.size();
    head.array_bytes = array_bytes_of(host->view());
    put(&head, sizeof head);
    put(text.data(), text.size());
    each_array(host->view(), 0, [&](auto* data, std::size_t n) { put(data, n * sizeof *data); });
    std::uint64_t const sum = hash;
    put(&sum, sizeof sum);
  };
}

/// Reads the parts of a map file, and no more of the stream.
class map_file_reader {
public:
  explicit map_file_reader(std::istream& from) : from_(from) {}

  /// @param loops whether they may follow @return whether they do
  /// @throws error for what is no map, is of another version, or has another origin
  bool read_head(map_origin const& origin, std::uint64_t array_bytes, bool loops) {
    map_file_head const ours;
    map_file_head head;
    auto* const bytes = reinterpret_cast<char*>(&head);
    if (!take(bytes, version_end) || std::memcmp(bytes, &ours, sizeof ours.magic) != 0) {
      throw error("ft: this is not a map of an odometry");
    }
    if (head.order != ours.order) {
      throw error("ft: the map file was written with another byte order");
    }
    if (head.version != ours.version) {
      throw error("ft: the map file has version " + std::to_string(head.version) +
                  ", this ft reads version " + std::to_string(ours.version) +
                  ": the map has to be made anew");
    }
    read(bytes + version_end, sizeof head - version_end);
    constexpr std::uint64_t most_text = 1 << 16;
    require_saved("bytes of text", head.text_bytes, std::uint64_t{0}, most_text);
    std::string text(static_cast<std::size_t>(head.text_bytes), '\0');
    read(text.data(), text.size());
    constexpr std::size_t line = sizeof loops_line - 1;
    bool const follow =
        text.size() >= line && text.compare(text.size() - line, line, loops_line) == 0;
    if (follow) { text.resize(text.size() - line); }
    origin.require_same(text);
    if (follow && !loops) {
      throw error("ft: the map was saved with loops, this odometry is without ft::loops");
    }
    require_saved("bytes of arrays", head.array_bytes, array_bytes, array_bytes);
    std::uint64_t const wanted = array_bytes + sizeof hash_;
    std::size_t const left = bytes_left(from_);  // 0: the stream cannot tell
    if (left != 0 && (follow ? left < wanted : left != wanted)) {
      throw error(
          "ft: the map file is truncated, or has bytes after its end: " + std::to_string(left) +
          " bytes follow its head, must be " + std::to_string(wanted));
    }
    return follow;
  }
  void read(void* to, std::size_t bytes) {
    if (!take(to, bytes)) { throw error("ft: the map file is truncated"); }
  }
  void read_hash() {
    std::uint64_t const wanted = hash_;
    std::uint64_t stored = 0;
    read(&stored, sizeof stored);
    if (stored != wanted) { throw error("ft: the map file is damaged"); }
  }

private:
  bool take(void* to, std::size_t bytes) {
    from_.read(static_cast<char*>(to), static_cast<std::streamsize>(bytes));
    if (static_cast<std::size_t>(from_.gcount()) != bytes) { return false; }
    hash_ = fnv1a(to, bytes, hash_);
    return true;
  }

  std::istream& from_;
  std::uint64_t hash_ = fnv1a_start;
};

/// Reads and checks a whole file before anything is changed. @param loops whether they may follow
/// @param read_loops called before anything is changed: whether they do
/// @throws error for a file that is truncated or damaged, of another version, rig, image size,
///   setting or capacity, or has numbers out of range
template <typename Exec, typename ReadLoops>
void load_odometry_map(Exec const& exec, odometry_map_view const& map, int b,
                       map_origin const& origin, int levels, std::istream& from, bool loops,
                       ReadLoops const& read_loops) {
  map_file_reader in(from);
  bool const follow = in.read_head(origin, array_bytes_of(map), loops);
  host_map<staging_space<Exec>> const host(map);
  each_array(host.view(), 0, [&](auto* data, std::size_t n) {
    in.read(static_cast<void*>(data), n * sizeof *data);
  });
  in.read_hash();
  check_saved_counts(host.view());
  clear_unused(host.view());
  check_saved_points(host.view());
  check_saved_keyframes(host.view(), levels);
  if (follow) {
    require_saved("keyframes of a map with loops", *host.view().keyframes.made, 1, most_counted);
  }
  read_loops(follow);
  host.upload(exec, map, b);
  fill_bytes(exec, map.records.found_frame + map.records.at(b, 0), 0,
             static_cast<std::size_t>(map.records.slots) * sizeof(int));
  exec.wait();
}

template <typename Engine>
map_origin origin_of(Engine const& of) {
  return {of.rig, of.stages.settings.orb, of.stages.own.map};
}

/// Of an odometry_engine, with what its parts write behind the map: odometry::snapshot_map().
template <typename Engine>
map_snapshot snapshot_of(Engine const& of, int b) {
  require(of.results[static_cast<std::size_t>(b)].state != tracking_state::initialising,
          "the camera has no map to be saved");
  odometry_map_view map = of.stages.own.map;
  for (auto const& part : of.stages.plugged) {
    if (part->loaded_map() != nullptr) { map = *part->loaded_map(); }
  }
  std::vector<map_snapshot::writer> parts;
  parts.push_back(odometry_map_writer(of.exec, map, b, origin_of(of), of.given.loops.present));
  for (auto const& part : of.stages.plugged) {
    if (auto write = part->save(of.exec)) { parts.push_back(std::move(write)); }
  }
  return map_snapshot(std::move(parts));
}

/// Into an odometry_engine: odometry::load_map().
template <typename Engine>
void load_into(Engine& to, std::istream& from, int b) {
  constexpr bool starts_from_motion = Engine::stages_type::starts_from_motion;
  bool has_loops = false;
  load_odometry_map(to.exec, to.stages.own.map, b, origin_of(to), to.stages.geometry().levels, from,
                    to.given.loops.present, [&](bool loops) {
                      has_loops = loops;
                      for (auto const& part : to.stages.plugged) {
                        part->read(loops ? &from : nullptr);
                      }
                    });
  auto const i = static_cast<std::size_t>(b);
  to.results[i] = {};
  to.results[i].state = to.stages.enter_loaded_map(to.exec, b, has_loops);
  if constexpr (starts_from_motion) { to.stages.beginning.forget(to.exec, b); }
  to.results[i].metric = !starts_from_motion;
  // An IMU is the first part, and comes last: loops know whether the map's unit is known.
  auto const& parts = to.stages.plugged;
  std::for_each(parts.rbegin(), parts.rend(),
                [&](auto const& part) { part->forget(to.exec, b, to.results[i]); });
  to.begun[i] = 0;
  to.stages.own.inputs[b].predicted = to.stages.own.inputs[b].reset = 0;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
