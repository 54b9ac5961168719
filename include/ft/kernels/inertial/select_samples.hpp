// SPDX-License-Identifier: Apache-2.0
/// @file Stage: selects the samples of an IMU that lie between two images, and makes the steps of
/// an integration of them.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

FT_HOST_DEVICE inline bool is_finite(imu_sample const& s) {
  return scalar::is_finite(s.time_s) && scalar::is_finite(s.accel.x) &&
         scalar::is_finite(s.accel.y) && scalar::is_finite(s.accel.z) &&
         scalar::is_finite(s.gyro.x) && scalar::is_finite(s.gyro.y) && scalar::is_finite(s.gyro.z);
}

/// What the samples from `first` to `last` are like.
struct sample_facts {
  bool finite = true;
  bool ascending = true;   ///< equal stamps included
  bool repeated = false;   ///< two equal stamps
  bool bad_end = false;    ///< a first or last step cannot be interpolated
  double longest = 0;      ///< time without a sample, s
  double shortest = 1e30;  ///< time between two samples, s

  FT_HOST_DEVICE void add(double time) {
    longest = max_of(longest, time);
    shortest = min_of(shortest, time);
    ascending = ascending && time >= 0;
    repeated = repeated || time == 0;
  }
};

template <typename Group>
FT_HOST_DEVICE sample_facts inspect(Group g, span<imu_sample const> samples,
                                    imu_interval const& between) {
  sample_facts facts;
  int const n = samples.size;
  for (int i = g.rank(); i < n; i += g.size()) {
    facts.finite = facts.finite && is_finite(samples[i]);
    if (i > 0) { facts.add(samples[i].time_s - samples[i - 1].time_s); }
  }
  facts.finite = !g.any(!facts.finite);
  facts.ascending = !g.any(!facts.ascending);
  facts.repeated = g.any(facts.repeated);
  facts.longest = g.reduce(facts.longest, max_op{});
  facts.shortest = g.reduce(facts.shortest, min_op{});
  if (n > 2) {
    facts.bad_end =
        samples[0].time_s == samples[1].time_s || samples[n - 2].time_s == samples[n - 1].time_s;
  }
  facts.longest = max_of(facts.longest, samples[0].time_s - between.from_s);
  facts.longest = max_of(facts.longest, between.to_s - samples[n - 1].time_s);
  return facts;
}

/// What comes of integrating these samples.
template <typename Group>
FT_HOST_DEVICE integration_status judge(Group g, span<imu_sample const> samples,
                                        imu_interval const& between, selection_params const& params,
                                        int capacity) {
  sample_facts const facts = inspect(g, samples, between);
  if (!facts.finite) { return integration_status::not_finite; }
  if (!facts.ascending) { return integration_status::unordered; }
  int const pairs = samples.size - 1;
  if (pairs == 0) { return integration_status::one_sample; }
  if (facts.bad_end) { return integration_status::unordered; }
  if (!(facts.longest <= params.longest_gap_s)) { return integration_status::gap; }
  if (params.rate_hz > 0 && pairs > 1) {
    double const period = 1.0 / static_cast<double>(params.rate_hz);
    double const mean = (samples[pairs].time_s - samples[0].time_s) / static_cast<double>(pairs);
    if (facts.shortest > params.rate_tolerance * period || mean * params.rate_tolerance < period) {
      return integration_status::wrong_rate;
    }
  }
  if (pairs > capacity) { return integration_status::too_many; }
  return facts.repeated ? integration_status::repeated : integration_status::integrated;
}

/// Mean of a signal over a step. Where an image cuts the step off, or comes after the samples,
/// `cut` is that share of the time between both samples.
FT_HOST_DEVICE inline vec3<float> mean_of(vec3<float> from, vec3<float> to, strict_float cut) {
  auto const one = [cut](strict_float a, strict_float b) {
    return ((a + b - (b - a) * cut) * strict_float(0.5f)).value;
  };
  return {one(from.x, to.x), one(from.y, to.y), one(from.z, to.z)};
}

FT_HOST_DEVICE inline imu_step make_step(span<imu_sample const> s, imu_interval const& between,
                                         int i) {
  auto const narrow = [](double v) { return static_cast<float>(v); };
  int const last = s.size - 2;
  if (last == 0) { return {s[0].accel, s[0].gyro, narrow(between.to_s - between.from_s)}; }
  imu_sample const& a = s[i];
  imu_sample const& b = s[i + 1];
  double const begin = i == 0 ? between.from_s : a.time_s;
  double const end = i == last ? between.to_s : b.time_s;
  strict_float cut = 0.0f;
  if (i == 0 || i == last) {
    double const outside = i == 0 ? a.time_s - between.from_s : b.time_s - between.to_s;
    cut = strict_float(narrow(outside)) / strict_float(narrow(b.time_s - a.time_s));
  }
  return {mean_of(a.accel, b.accel, cut), mean_of(a.gyro, b.gyro, cut), narrow(end - begin)};
}

/// The first sample from `begin` on with a property, or the number of samples.
template <typename Group, typename Property>
FT_HOST_DEVICE int first_sample(Group g, span<imu_sample const> queue, int begin,
                                Property const& has) {
  int found = queue.size;
  for (int i = begin + g.rank(); i < found; i += g.size()) {
    if (has(queue[i])) { found = i; }
  }
  return g.reduce(found, min_op{});
}

/// select_samples() by a group, whose threads all get the result.
template <typename Group>
FT_HOST_DEVICE imu_selection select_samples_by(Group g, span<imu_sample const> queue,
                                               imu_interval const& between,
                                               selection_params const& params, imu_step* steps,
                                               int capacity) {
  imu_selection out{0, 0, 0, 0, integration_status::no_samples};
  if (queue.size == 0) { return out; }
  if (!(scalar::is_finite(between.from_s) && scalar::is_finite(between.to_s))) {
    out.status = integration_status::not_finite;
    return out;
  }
  if (!(between.from_s < between.to_s)) {
    out.status = integration_status::unordered;
    return out;
  }
  int const first = first_sample(g, queue, 0, [&](imu_sample const& s) {
    return !(s.time_s < between.from_s - params.early_s);
  });
  out.dropped = first;
  // A stamp that is not finite belongs to no time.
  int const end = first_sample(g, queue, first, [&](imu_sample const& s) {
    return s.time_s >= between.to_s - params.early_s && scalar::is_finite(s.time_s);
  });
  out.removed = end;
  out.taken = min_of(end + 1, queue.size) - first;
  if (out.taken == 0) {
    out.status = integration_status::no_steps;
    return out;
  }
  span<imu_sample const> const taken{queue.data + first, out.taken};
  out.status = judge(g, taken, between, params, capacity);
  if (end < queue.size) {
    bool const ahead = end + 1 < queue.size && queue[end + 1].time_s < queue[end].time_s;
    if (ahead) { out.status = integration_status::unordered; }
    // A faulty sample that stayed would spoil the next intervals, too.
    if (ahead || !is_finite(queue[end])) { ++out.removed; }
  }
  if (!usable(out.status)) { return out; }
  out.steps = out.taken - 1;
  for (int i = g.rank(); i < out.steps; i += g.size()) { steps[i] = make_step(taken, between, i); }
  return out;
}

}  // namespace detail

/// Selects the samples between two images and makes their steps. Equal bits on every executor.
/// Measurements change linearly between samples; what lies before the first or after the last one
/// is extrapolated. A selection whose status is not usable() has no steps.
/// @param queue samples, oldest first
/// @param steps memory for as many as `capacity`
FT_HOST_DEVICE inline imu_selection select_samples(span<imu_sample const> queue,
                                                   imu_interval const& between,
                                                   selection_params const& params, imu_step* steps,
                                                   int capacity) {
  return detail::select_samples_by(single_group{}, queue, between, params, steps, capacity);
}

namespace detail {

/// Item: an interval.
struct select_interval {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, imu_sample const* samples,
                                 imu_interval const* intervals, selection_params const& params,
                                 imu_steps_view const& out) const {
    imu_interval const between = intervals[item];
    imu_selection const chosen = select_samples_by(g, {samples + between.first, between.count},
                                                   between, params, out.of(item), out.capacity);
    if (g.rank() == 0) { out.chosen[item] = chosen; }
  }
};

}  // namespace detail

/// Selects the samples of many intervals; see the function for one.
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @param samples of all queues, which may overlap; each interval says where its own are
/// @param intervals [out.intervals]
template <typename Exec>
void select_samples(Exec const& exec, imu_sample const* samples, imu_interval const* intervals,
                    selection_params const& params, imu_steps_view const& out) {
  for_each_item<per_warp>(exec, out.intervals, detail::select_interval{}, samples, intervals,
                          params, out);
}

}  // namespace FT_ABI
}  // namespace ft
