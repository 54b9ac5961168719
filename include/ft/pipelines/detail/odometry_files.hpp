// SPDX-License-Identifier: Apache-2.0
/// @file The map of a camera as a file.
///
/// Version 1, little-endian, without padding:
/// - 16 bytes "ft odometry map" and 0; uint32 version; uint32 0x01020304;
/// - int32 slots, words of a mask, keyframe positions, searched cameras, keypoints of an image,
///   pyramid levels; uint64 bytes of the arrays;
/// - the arrays in the order of each_array(), of one camera pair;
/// - uint64 FNV-1a hash of all bytes before it (Fowler, Noll, Vo).
///
/// A file fits an odometry with the same six numbers.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <istream>
#include <iterator>
#include <ostream>
#include <string>
#include <vector>

#include "ft/containers/odometry_map.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/pipelines/detail/odometry_download.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Calls visit(data, count) for every array of batch entry b.
template <typename Visit>
void each_array(odometry_map_view const& map, int b, Visit const& visit) {
  auto const n = static_cast<std::size_t>(map.records.slots);
  auto const points = map.points.slice(b);
  visit(array_of<field::position>(points), n);
  visit(array_of<field::normal>(points), n);
  visit(array_of<field::min_distance>(points), n);
  visit(array_of<field::max_distance>(points), n);
  visit(array_of<field::orb>(points), n);
  visit(array_of<field::observations>(points), n);
  point_records_view const& r = map.records;
  auto const slot = r.at(b, 0);
  int* const by_slot[] = {r.number, r.visible, r.found, r.described};
  for (int* const column : by_slot) { visit(column + slot, n); }
  visit(r.recent + slot * point_descriptors, n * point_descriptors);
  visit(r.mask(b, 0), n * static_cast<std::size_t>(r.words));
  keyframes_view const& k = map.keyframes;
  int* const one[] = {r.made, r.alive, r.used, k.made, k.count};
  for (int* const number : one) { visit(number + b, std::size_t{1}); }
  auto const positions = static_cast<std::size_t>(k.positions);
  visit(k.T_cw + k.at(b, 0), positions);
  visit(k.time_ns + k.at(b, 0), positions);
  visit(k.neighbour + k.at(b, 0), positions);
  visit(k.shared + k.at(b, 0), positions);
  visit(k.keypoints + k.at(b, 0) * k.cameras, positions * static_cast<std::size_t>(k.cameras));
  auto const numbers = positions * static_cast<std::size_t>(k.numbers());
  float* const pixels[] = {k.x, k.y, k.right_x};
  for (float* const column : pixels) { visit(column + k.at(b, 0, 0), numbers); }
  int* const holders[] = {k.octave, k.holder, k.holder_number};
  for (int* const column : holders) { visit(column + k.at(b, 0, 0), numbers); }
}

inline std::uint64_t fnv1a(unsigned char const* data, std::size_t bytes) {
  std::uint64_t hash = 0xcbf29ce484222325u;
  for (std::size_t i = 0; i < bytes; ++i) { hash = (hash ^ data[i]) * 0x100000001b3u; }
  return hash;
}

/// The bytes before the arrays.
inline std::vector<unsigned char> map_file_head(odometry_map_view const& map, int levels) {
  std::uint64_t bytes = 0;
  each_array(map, 0, [&](auto* data, std::size_t n) { bytes += n * sizeof *data; });
  std::vector<unsigned char> head;
  auto const put = [&](auto const& value) {
    auto const* const from = reinterpret_cast<unsigned char const*>(&value);
    head.insert(head.end(), from, from + sizeof value);
  };
  put("ft odometry map");
  put(std::uint32_t{1});
  put(std::uint32_t{0x01020304});
  keyframes_view const& k = map.keyframes;
  put(map.records.slots);
  put(map.records.words);
  put(k.positions);
  put(k.cameras);
  put(k.capacity);
  put(levels);
  put(bytes);
  return head;
}

/// @throws error if the stream cannot be written; std::bad_alloc, cuda_error
template <typename Exec>
void save_odometry_map(Exec const& exec, odometry_map_view const& map, int b, int levels,
                       std::ostream& to) {
  std::vector<unsigned char> file = map_file_head(map, levels);
  each_array(map, b, [&](auto* data, std::size_t n) {
    auto const values = downloaded(exec, data, n);
    auto const* const from = reinterpret_cast<unsigned char const*>(values.data());
    file.insert(file.end(), from, from + n * sizeof *data);
  });
  std::uint64_t const hash = fnv1a(file.data(), file.size());
  auto const size = static_cast<std::streamsize>(file.size());
  to.write(reinterpret_cast<char const*>(file.data()), size);
  to.write(reinterpret_cast<char const*>(&hash), sizeof hash);
  to.flush();
  if (!to) { throw error("ft: the map could not be written"); }
}

/// Refuses arrays that stages would follow out of bounds.
/// @param host views whose arrays are in host memory, batch entry 0
inline void check_loaded_map(odometry_map_view const& host, int levels) {
  keyframes_view const& k = host.keyframes;
  point_records_view const& r = host.records;
  bool good = *r.alive >= 0 && *r.alive <= r.slots && *r.used >= 0 && *r.used <= r.slots &&
              *r.made >= 0 && *k.count >= 0 && *k.count <= k.positions && *k.made >= *k.count;
  for (int i = 0; i < k.positions * k.cameras; ++i) {
    bool const used = i / k.cameras < *k.made;
    good = good && (!used || (k.keypoints[i] >= 0 && k.keypoints[i] <= k.capacity));
  }
  for (int n = good ? *k.made - *k.count + 1 : 1; good && n <= *k.made; ++n) {
    int const p = k.position(n);
    for (double const v : k.T_cw[p].R.m) { good = good && std::isfinite(v); }
    good = good && std::isfinite(k.T_cw[p].t.x + k.T_cw[p].t.y + k.T_cw[p].t.z);
    good = good && k.neighbour[p] >= 0 && k.neighbour[p] <= *k.made;
    for (int c = 0; c < k.cameras; ++c) {
      for (int i = 0; i < k.keypoints[p * k.cameras + c]; ++i) {
        auto const at = static_cast<std::size_t>(k.at(0, p, c * k.capacity + i));
        good = good && k.holder[at] >= -1 && k.holder[at] < r.slots && k.octave[at] >= 0 &&
               k.octave[at] < levels;
      }
    }
  }
  if (!good) { throw error("ft: the map file has numbers out of range"); }
}

/// Reads a whole file before anything is changed.
/// @throws error for a file that is truncated, damaged, of another version or other capacities
template <typename Exec>
void load_odometry_map(Exec const& exec, odometry_map_view const& map, int b, int levels,
                       std::istream& from) {
  std::vector<char> const file{std::istreambuf_iterator<char>(from),
                               std::istreambuf_iterator<char>()};
  auto const* const bytes = reinterpret_cast<unsigned char const*>(file.data());
  std::vector<unsigned char> const head = map_file_head(map, levels);
  if (file.size() < 24 || std::memcmp(bytes, head.data(), 16) != 0) {
    throw error("ft: this is not a map of an odometry");
  }
  if (std::memcmp(bytes + 16, head.data() + 16, 8) != 0) {
    throw error("ft: the map file has another version or byte order");
  }
  if (file.size() < head.size() || std::memcmp(bytes, head.data(), head.size()) != 0) {
    throw error("ft: the map file was written with other capacities, or is truncated");
  }
  std::uint64_t payload = 0;
  std::memcpy(&payload, head.data() + head.size() - sizeof payload, sizeof payload);
  std::uint64_t hash = 0;
  if (file.size() != head.size() + payload + sizeof hash) {
    throw error("ft: the map file is truncated, or has bytes after its end");
  }
  std::memcpy(&hash, bytes + file.size() - sizeof hash, sizeof hash);
  if (hash != fnv1a(bytes, file.size() - sizeof hash)) {
    throw error("ft: the map file is damaged");
  }
  // In host memory first, to be checked; then in the executor's.
  odometry_map_view host;
  odometry_map_capacity const size{
      map.records.slots, {map.keyframes.positions, map.keyframes.cameras, map.keyframes.capacity}};
  arena<staging_space<Exec>> const memory([&](carver& c) { carve(c, host, size, 1); });
  std::size_t at = head.size();
  each_array(host, 0, [&](auto* data, std::size_t n) {
    std::memcpy(static_cast<void*>(data), bytes + at, n * sizeof *data);
    at += n * sizeof *data;
  });
  check_loaded_map(host, levels);
  std::vector<void const*> arrays;
  each_array(host, 0, [&](auto* data, std::size_t) { arrays.push_back(data); });
  std::size_t next = 0;
  each_array(map, b, [&](auto* data, std::size_t n) {
    copy_bytes(exec, data, arrays[next++], n * sizeof *data);
  });
  fill_bytes(exec, map.records.found_frame + map.records.at(b, 0), 0,
             static_cast<std::size_t>(map.records.slots) * sizeof(int));
  exec.wait();
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
