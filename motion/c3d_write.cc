#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <ostream>
#include <utility>

#include "motion/c3d.h"
#include "motion/c3d_format.h"
#include "motion/vax_float.h"
#include "motion/whole_file.h"

namespace secondskin {
namespace {

using c3d::kBlock;
using c3d::kLargestWord;

constexpr std::size_t kParameterBlock = 2;
constexpr std::size_t kMostInList = 255;
// A record's length is a 16-bit number, which some programs read as signed.
constexpr std::size_t kMostBytesInList = 32000;
// Integer storage: the largest value is stored as this, which c3d.org recommends.
constexpr double kIntegerSteps = 32000.0;
constexpr double kMostSteps = 255.0;  // of a residual, which has one byte

[[noreturn]] void fail(std::string_view what) { throw C3dError(fmt::format("C3D: {}", what)); }

// Numbers in the file's byte order.
class Encoder {
 public:
  explicit Encoder(C3dProcessor processor) : processor_(processor) {}

  void u8(std::size_t value) { bytes_.push_back(static_cast<char>(value)); }
  void u16(std::size_t value) {
    const auto low = static_cast<char>(value & 0xFFU), high = static_cast<char>(value >> 8 & 0xFFU);
    const bool high_first = processor_ == C3dProcessor::kSgi;
    bytes_.push_back(high_first ? high : low);
    bytes_.push_back(high_first ? low : high);
  }
  void i16(std::int64_t value) { u16(static_cast<std::size_t>(value) & 0xFFFFU); }
  void f32(float value) {
    if (processor_ == C3dProcessor::kDec) {
      const auto vax = vax_from_float(value);
      if (!vax) fail(fmt::format("{:g} is more than a DEC file can hold", value));
      u16(*vax >> 16);
      u16(*vax & 0xFFFFU);
      return;
    }
    const auto bits = std::bit_cast<std::uint32_t>(value);
    const bool high_first = processor_ == C3dProcessor::kSgi;
    u16(high_first ? bits >> 16 : bits & 0xFFFFU);
    u16(high_first ? bits & 0xFFFFU : bits >> 16);
  }
  void text(std::string_view text) { bytes_.append(text); }
  void pad_to_block() { bytes_.resize((bytes_.size() + kBlock - 1) / kBlock * kBlock, '\0'); }

  std::size_t size() const noexcept { return bytes_.size(); }
  std::string take() { return std::move(bytes_); }

 private:
  C3dProcessor processor_;
  std::string bytes_;
};

float to_float(double value) {
  const auto single = static_cast<float>(value);
  if (std::isfinite(value) && !std::isfinite(single)) {
    fail(fmt::format("{:g} is more than a file can hold", value));
  }
  return single;
}

C3dParameter text_parameter(std::string name, const std::string& text) {
  if (text.size() > kMostInList) fail(fmt::format("{} is longer than 255 letters: {}", name, text));
  return {.name = std::move(name),
          .dimensions = {static_cast<std::uint8_t>(text.size())},
          .values = text};
}
C3dParameter word_parameter(std::string name, std::size_t value) {
  return {.name = std::move(name),
          .values = std::vector{static_cast<std::int16_t>(std::min(value, kLargestWord))}};
}
C3dParameter real_parameter(std::string name, double value) {
  return {.name = std::move(name), .values = std::vector{to_float(value)}};
}

class Writer {
 public:
  Writer(const C3dFile& content, C3dProcessor processor, C3dStorage storage)
      : in_(content), real_(storage == C3dStorage::kReal), out_(processor), processor_(processor) {
    file_.groups = content.groups;
  }

  std::string write() {
    check();
    choose_point_scale();
    choose_channel_scales();
    set_point_group();
    set_analog_group();
    set_frame_numbers();
    set_events();
    // The sections' lengths do not depend on the pointer's value.
    set("POINT", word_parameter("DATA_START", 0));
    const std::size_t blocks = parameter_section(0).size() / kBlock;
    if (blocks > kMostInList) fail(fmt::format("{} blocks of parameters, at most 255", blocks));
    data_start_ = kParameterBlock + blocks;
    set("POINT", word_parameter("DATA_START", data_start_));
    write_header();
    out_.text(parameter_section(blocks));
    write_data();
    return out_.take();
  }

 private:
  void check() {
    const MarkerMotion& m = in_.markers;
    points_ = m.names.size() + in_.derived.size();
    if (points_ > kLargestWord) fail(fmt::format("{} points, at most 65535", points_));
    if (m.frames.empty()) fail("no frames");
    if (points_ + in_.analog.size() == 0) fail("neither points nor analog channels");
    if (!(m.rate_hz >= 1e-3 && m.rate_hz <= 1e6)) {
      fail(fmt::format("a rate of {} Hz, expected 0.001 to 1000000", m.rate_hz));
    }
    for (const MarkerFrame& frame : m.frames) {
      if (frame.p_WM.size() != m.names.size() || frame.visible.size() != m.names.size() ||
          frame.residual.size() != m.names.size()) {
        fail(fmt::format("a frame of {} markers, expected {}", frame.p_WM.size(), m.names.size()));
      }
    }
    for (const C3dDerived& d : in_.derived) {
      if (d.values.size() != m.frames.size() || d.valid.size() != m.frames.size()) {
        fail(fmt::format("{} values of {}, expected {}", d.values.size(), d.name, m.frames.size()));
      }
    }
    if (!in_.analog.empty()) samples_ = in_.analog.front().values.size() / m.frames.size();
    if (samples_ * in_.analog.size() > kLargestWord) {
      fail(fmt::format("{} analog samples a frame, at most 65535", samples_ * in_.analog.size()));
    }
    for (const C3dAnalog& channel : in_.analog) {
      if (samples_ == 0 || channel.values.size() != samples_ * m.frames.size()) {
        fail(
            fmt::format("{} samples of channel {}, expected the same whole number in each of {} "
                        "frames as every channel has",
                        channel.values.size(), channel.name, m.frames.size()));
      }
    }
    std::string unit;
    if (const C3dParameter* p = in_.find("POINT", "UNITS"); p && !p->strings().empty()) {
      unit = p->strings().front();
    }
    metres_ = c3d::metres_per_unit(unit);
    if (metres_ == 0.0)
      fail(fmt::format("POINT:UNITS is \"{}\", expected mm, cm, m, in or ft", unit));
    has_unit_ = !unit.empty();
  }

  // Calls use(values, is_there, residual) for every point of a frame in the file's order, in the
  // file's unit.
  template <typename Use>
  void for_each_point(std::size_t frame, Use use) const {
    const MarkerFrame& m = in_.markers.frames[frame];
    for (std::size_t i = 0; i < m.p_WM.size(); ++i) {
      const double residual = std::isfinite(m.residual[i]) ? m.residual[i] / metres_ : 0.0;
      use(Eigen::Vector3d(m.p_WM[i] / metres_), m.visible[i] != 0, residual);
    }
    for (const C3dDerived& d : in_.derived) use(d.values[frame], d.valid[frame] != 0, 0.0);
  }

  // Integer coordinates and, in both storages, residuals are in steps of POINT:SCALE.
  void choose_point_scale() {
    const C3dParameter* old = in_.find("POINT", "SCALE");
    const std::vector<double> values = old != nullptr ? old->numbers() : std::vector<double>();
    const double kept = values.empty() ? 0.0 : std::abs(values.front());
    double largest = 0.0;
    double least_residual = std::numeric_limits<double>::infinity(), most_residual = 0.0;
    bool whole_steps = std::isnormal(kept);  // of the scale kept
    for (std::size_t f = 0; f < in_.markers.frames.size(); ++f) {
      for_each_point(f, [&](const Eigen::Vector3d& p, bool valid, double residual) {
        if (!valid) return;
        // The comparisons also refuse NaN.
        if (!(p.cwiseAbs().maxCoeff() <= c3d::kLargestValue)) {
          fail(fmt::format("a point in frame {} is not finite or above 1e9", f + 1));
        }
        largest = std::max(largest, p.cwiseAbs().maxCoeff());
        for (const double value : p) whole_steps = whole_steps && is_whole(value / kept);
        if (!(residual > 0.0)) return;
        least_residual = std::min(least_residual, residual);
        most_residual = std::max(most_residual, residual);
      });
    }
    // Floats, as a reader will see them.
    const auto finest = static_cast<float>(largest / kIntegerSteps);
    const auto for_residuals = static_cast<float>(most_residual / kMostSteps);
    const auto holds_residuals = [&](double scale) {
      return std::isnormal(scale) && least_residual / scale >= 0.5 &&
             most_residual / scale <= kMostSteps + 0.5;
    };
    const bool keeps =
        real_ ? holds_residuals(kept)
              : whole_steps && largest / kept <= std::numeric_limits<std::int16_t>::max();
    if (keeps) {
      scale_ = kept;
    } else if (std::isnormal(finest) && (!real_ || holds_residuals(finest))) {
      scale_ = finest;
    } else {
      scale_ = std::isnormal(for_residuals) ? for_residuals : 1.0;
    }
  }
  static bool is_whole(double steps) noexcept {
    constexpr double kRounding = 1e-3;
    return std::abs(steps - std::round(steps)) <= kRounding;
  }

  struct Coding {
    double scale = 1.0;  // general scale included, as a reader will compute it
    double stored_scale = 1.0;
    double offset = 0.0;
  };

  void choose_channel_scales() {
    const C3dParameter* format = in_.find("ANALOG", "FORMAT");
    is_unsigned_ = format != nullptr && !format->strings().empty() &&
                   c3d::equals_ignoring_case(format->strings().front(), "UNSIGNED");
    const C3dParameter* general = in_.find("ANALOG", "GEN_SCALE");
    if (general != nullptr && !general->numbers().empty()) general_ = general->numbers().front();
    if (!std::isnormal(general_)) general_ = 1.0;
    const double lowest = is_unsigned_ ? 0.0 : -32768.0;
    const double highest = is_unsigned_ ? 65535.0 : 32767.0;
    for (const C3dAnalog& channel : in_.analog) {
      Coding coding;
      const auto scaled = [&](double scale) {
        coding.stored_scale = to_float(scale / general_);
        coding.scale = coding.stored_scale * general_;
      };
      scaled(channel.scale);
      if (!std::isnormal(coding.stored_scale)) scaled(1.0);
      coding.offset = channel.offset;
      if (!(coding.offset >= lowest && coding.offset <= highest) ||
          coding.offset != std::round(coding.offset)) {
        coding.offset = 0.0;
      }
      if (!real_) {
        double largest = 0.0;
        bool fits = true;
        for (const double value : channel.values) {
          if (!std::isfinite(value)) {
            fail(fmt::format("channel {} has a sample that integers cannot hold", channel.name));
          }
          const double stored = value / coding.scale + coding.offset;
          fits = fits && stored > lowest - 0.5 && stored < highest + 0.5 && is_whole(stored);
          largest = std::max(largest, std::abs(value));
        }
        if (!fits) {
          coding.offset = is_unsigned_ ? 32768.0 : 0.0;
          scaled(largest / kIntegerSteps);
        }
      }
      codings_.push_back(coding);
    }
  }

  // Description and lock of a parameter that is replaced stay.
  void set(std::string_view group, C3dParameter parameter) {
    if (const C3dParameter* old = file_.find(group, parameter.name)) {
      parameter.description = old->description;
      parameter.locked = old->locked;
    }
    file_.set(group, std::move(parameter));
  }
  void erase(std::string_view group, std::string_view name) {
    for (C3dGroup& g : file_.groups) {
      if (!c3d::equals_ignoring_case(g.name, group)) continue;
      std::erase_if(g.parameters,
                    [&](const C3dParameter& p) { return c3d::equals_ignoring_case(p.name, name); });
    }
  }
  void erase_continued(std::string_view group, std::string_view name, std::size_t from) {
    for (std::size_t part = from; file_.find(group, c3d::continued(name, part)); ++part) {
      erase(group, c3d::continued(name, part));
    }
  }

  // A list of any length, in parameters of at most 255 each. An empty one is left out.
  void set_strings(std::string_view group, std::string_view name,
                   const std::vector<std::string>& strings) {
    std::size_t length = 1;
    for (const std::string& s : strings) {
      if (s.size() > kMostInList) {
        fail(fmt::format("{}:{} has one of more than 255 letters: {}", group, name, s));
      }
      length = std::max(length, s.size());
    }
    set_parts(group, name, strings.size(), std::min(kMostInList, kMostBytesInList / length),
              [&](C3dParameter& p, std::size_t from, std::size_t to) {
                std::string text;
                for (std::size_t i = from; i < to; ++i) {
                  text += strings[i];
                  text.append(length - strings[i].size(), ' ');
                }
                p.dimensions.insert(p.dimensions.begin(), static_cast<std::uint8_t>(length));
                p.values = std::move(text);
              });
  }
  template <typename T, typename Value>
  void set_numbers(std::string_view group, std::string_view name, std::size_t count, Value value) {
    set_parts(group, name, count, kMostInList,
              [&](C3dParameter& p, std::size_t from, std::size_t to) {
                std::vector<T> values;
                for (std::size_t i = from; i < to; ++i) values.push_back(value(i));
                p.values = std::move(values);
              });
  }
  template <typename Fill>
  void set_parts(std::string_view group, std::string_view name, std::size_t count, std::size_t most,
                 Fill fill) {
    std::size_t part = 1;
    for (std::size_t from = 0; from < count; ++part) {
      const std::size_t to = std::min(count, from + most);
      C3dParameter p{.name = c3d::continued(name, part),
                     .dimensions = {static_cast<std::uint8_t>(to - from)}};
      fill(p, from, to);
      set(group, std::move(p));
      from = to;
    }
    erase_continued(group, name, part);
  }

  void set_point_group() {
    const std::size_t frames = in_.markers.frames.size();
    set("POINT", word_parameter("USED", points_));
    set("POINT", word_parameter("FRAMES", frames));
    if (frames >= kLargestWord || file_.find("POINT", "LONG_FRAMES") != nullptr) {
      set("POINT", real_parameter("LONG_FRAMES", static_cast<double>(frames)));
    }
    set("POINT", real_parameter("SCALE", real_ ? -scale_ : scale_));
    set("POINT", real_parameter("RATE", in_.markers.rate_hz));
    if (!has_unit_) set("POINT", text_parameter("UNITS", "mm"));

    std::vector<std::string> labels = in_.markers.names;
    std::vector<std::string> descriptions = in_.marker_descriptions;
    descriptions.resize(in_.markers.names.size());
    for (const C3dDerived& d : in_.derived) {
      labels.push_back(d.name);
      descriptions.push_back(d.description);
    }
    set_strings("POINT", "LABELS", labels);
    const bool described =
        std::any_of(descriptions.begin(), descriptions.end(), [](auto& d) { return !d.empty(); });
    set_strings("POINT", "DESCRIPTIONS", described ? descriptions : std::vector<std::string>());
    for (const c3d::KindParameters& kind : c3d::kKinds) {
      std::vector<std::string> names;
      std::string unit;
      for (const C3dDerived& d : in_.derived) {
        if (d.kind != kind.kind) continue;
        if (!names.empty() && d.unit != unit) {
          fail(fmt::format("{} is in {}, others of POINT:{} in {}", d.name, d.unit, kind.list,
                           unit));
        }
        names.push_back(d.name);
        unit = d.unit;
      }
      set_strings("POINT", kind.list, names);
      if (!names.empty()) set("POINT", text_parameter(std::string(kind.units), unit));
    }
  }

  void set_analog_group() {
    const std::size_t n = in_.analog.size();
    const bool has_group =
        std::any_of(file_.groups.begin(), file_.groups.end(),
                    [](const C3dGroup& g) { return c3d::equals_ignoring_case(g.name, "ANALOG"); });
    if (n == 0 && !has_group) return;
    set("ANALOG", word_parameter("USED", n));
    set("ANALOG",
        real_parameter(
            "RATE", in_.markers.rate_hz * static_cast<double>(std::max<std::size_t>(samples_, 1))));
    set("ANALOG", real_parameter("GEN_SCALE", general_));
    std::vector<std::string> labels, descriptions, units;
    for (const C3dAnalog& channel : in_.analog) {
      labels.push_back(channel.name);
      descriptions.push_back(channel.description);
      units.push_back(channel.unit);
    }
    set_strings("ANALOG", "LABELS", labels);
    set_strings("ANALOG", "DESCRIPTIONS", descriptions);
    set_strings("ANALOG", "UNITS", units);
    set_numbers<float>("ANALOG", "SCALE", n,
                       [&](std::size_t i) { return to_float(codings_[i].stored_scale); });
    set_numbers<std::int16_t>("ANALOG", "OFFSET", n, [&](std::size_t i) {
      return static_cast<std::int16_t>(static_cast<std::int64_t>(codings_[i].offset));
    });
  }

  std::size_t last_frame() const noexcept {
    return in_.first_frame + in_.markers.frames.size() - 1;
  }

  void set_frame_numbers() {
    const auto field = [&](std::string_view name, std::size_t number) {
      if (number > 0xFFFFFFFFU) fail(fmt::format("frame number {}", number));
      set("TRIAL", {.name = std::string(name),
                    .dimensions = {2},
                    .values = std::vector{static_cast<std::int16_t>(number & 0xFFFFU),
                                          static_cast<std::int16_t>(number >> 16)}});
    };
    field("ACTUAL_START_FIELD", in_.first_frame);
    field("ACTUAL_END_FIELD", last_frame());
  }

  void set_events() {
    const std::size_t n = in_.events.size();
    for (C3dGroup& g : file_.groups) {
      if (!c3d::equals_ignoring_case(g.name, "EVENT")) continue;
      // Lists of another length than the events' belong to events that are no longer there.
      std::erase_if(g.parameters, [&](const C3dParameter& p) {
        const bool is_list =
            p.dimensions.size() > 1 ||
            (p.dimensions.size() == 1 && !std::holds_alternative<std::string>(p.values));
        return is_list && p.dimensions.back() != n;
      });
      set("EVENT", word_parameter("USED", n));
    }
    if (n == 0) return;
    if (n > kMostInList) fail(fmt::format("{} events, at most 255", n));
    std::vector<std::string> labels, contexts;
    std::vector<float> times;
    for (const C3dEvent& event : in_.events) {
      labels.push_back(event.label);
      contexts.push_back(event.context);
      times.push_back(0.0F);  // minutes
      times.push_back(to_float(event.time));
    }
    set("EVENT", word_parameter("USED", n));
    set_strings("EVENT", "LABELS", labels);
    set_strings("EVENT", "CONTEXTS", contexts);
    set("EVENT", {.name = "TIMES",
                  .dimensions = {2, static_cast<std::uint8_t>(n)},
                  .values = std::move(times)});
  }

  void write_header() {
    out_.u8(kParameterBlock);
    out_.u8(c3d::kKey);
    out_.u16(points_);
    out_.u16(samples_ * in_.analog.size());
    out_.u16(std::min(in_.first_frame, kLargestWord));
    out_.u16(std::min(last_frame(), kLargestWord));
    out_.u16(0);  // interpolated gaps: none
    out_.f32(to_float(real_ ? -scale_ : scale_));
    out_.u16(data_start_);
    out_.u16(samples_);
    out_.f32(to_float(in_.markers.rate_hz));
    out_.pad_to_block();
  }

  std::string parameter_section(std::size_t blocks) const {
    Encoder out(processor_);
    out.u8(1);
    out.u8(c3d::kKey);
    out.u8(blocks);
    out.u8(static_cast<std::size_t>(processor_));
    std::size_t id = 0;
    constexpr std::size_t kMostGroups = 127;
    const auto begin_record = [&](const std::string& name, bool locked, std::size_t number) {
      if (name.empty() || name.size() > 127) {
        fail(fmt::format("the name \"{}\" of a parameter, expected 1 to 127 letters", name));
      }
      out.u8(locked ? 256 - name.size() : name.size());
      out.u8(number);
      out.text(name);
    };
    const auto described = [](const std::string& text) {
      return std::string_view(text).substr(0, kMostInList);
    };
    for (const C3dGroup& g : file_.groups) {
      if (g.name.empty()) continue;
      if (++id > kMostGroups) fail("more than 127 groups of parameters");
      const std::string_view description = described(g.description);
      begin_record(g.name, g.locked, 256 - id);
      out.u16(3 + description.size());
      out.u8(description.size());
      out.text(description);
      for (const C3dParameter& p : g.parameters) write_parameter(out, g, p, id, begin_record);
    }
    out.u16(0);
    out.pad_to_block();
    return out.take();
  }

  template <typename Begin>
  static void write_parameter(Encoder& out, const C3dGroup& g, const C3dParameter& p,
                              std::size_t id, Begin begin_record) {
    std::size_t count = 1;
    for (const std::uint8_t d : p.dimensions) count *= d;
    const auto [held, width, type] = std::visit(
        [](const auto& v) {
          using V = std::decay_t<decltype(v)>;
          if constexpr (std::is_same_v<V, std::string>) {
            return std::tuple{v.size(), std::size_t{1}, -1};
          } else {
            return std::tuple{v.size(), sizeof(typename V::value_type),
                              static_cast<int>(sizeof(typename V::value_type))};
          }
        },
        p.values);
    if (p.dimensions.size() > 7 || held != count) {
      fail(fmt::format("{}:{} has {} values in {} dimensions, expected {} in at most 7", g.name,
                       p.name, held, p.dimensions.size(), count));
    }
    const std::string_view description = std::string_view(p.description).substr(0, kMostInList);
    const std::size_t length = 2 + 2 + p.dimensions.size() + count * width + 1 + description.size();
    if (length > kLargestWord) {
      fail(fmt::format("{}:{} takes {} bytes, at most 65535", g.name, p.name, length));
    }
    begin_record(p.name, p.locked, id);
    out.u16(length);
    out.u8(static_cast<std::uint8_t>(type));
    out.u8(p.dimensions.size());
    for (const std::uint8_t d : p.dimensions) out.u8(d);
    std::visit(
        [&](const auto& v) {
          using V = std::decay_t<decltype(v)>;
          if constexpr (std::is_same_v<V, std::string>) {
            out.text(v);
          } else {
            for (const auto value : v) {
              if constexpr (std::is_same_v<V, std::vector<float>>) {
                out.f32(value);
              } else if constexpr (std::is_same_v<V, std::vector<std::int16_t>>) {
                out.i16(value);
              } else {
                out.u8(static_cast<std::uint8_t>(value));
              }
            }
          }
        },
        p.values);
    out.u8(description.size());
    out.text(description);
  }

  void write_data() {
    for (std::size_t f = 0; f < in_.markers.frames.size(); ++f) {
      for_each_point(f, [&](const Eigen::Vector3d& p, bool valid, double residual) {
        // The lower byte of the fourth word: the residual in steps of the scale, 0 for unknown.
        const double fourth = !valid ? -1.0
                              : residual > 0.0
                                  ? std::clamp(std::round(residual / scale_), 1.0, kMostSteps)
                                  : 0.0;
        for (int k = 0; k < 3; ++k) {
          const double value = valid ? p[k] : 0.0;
          if (real_) {
            out_.f32(to_float(value));
          } else {
            out_.i16(std::llround(value / scale_));
          }
        }
        if (real_) {
          out_.f32(static_cast<float>(fourth));
        } else {
          out_.i16(static_cast<std::int64_t>(fourth));
        }
      });
      for (std::size_t s = 0; s < samples_; ++s) {
        for (std::size_t c = 0; c < in_.analog.size(); ++c) {
          const double stored =
              in_.analog[c].values[f * samples_ + s] / codings_[c].scale + codings_[c].offset;
          if (real_) {
            out_.f32(to_float(stored));
          } else {
            out_.i16(std::llround(stored));
          }
        }
      }
    }
    out_.pad_to_block();
  }

  const C3dFile& in_;
  C3dFile file_;  // the parameters to be written
  bool real_;
  Encoder out_;
  C3dProcessor processor_;
  std::size_t points_ = 0;
  std::size_t samples_ = 0;  // of each channel a frame
  std::size_t data_start_ = 0;
  double metres_ = 0.001;
  bool has_unit_ = false;
  double scale_ = 1.0;
  double general_ = 1.0;
  bool is_unsigned_ = false;
  std::vector<Coding> codings_;
};

}  // namespace

void write_c3d(const C3dFile& content, const std::filesystem::path& file, C3dProcessor processor,
               C3dStorage storage) {
  write_whole_file(file, Writer(content, processor, storage).write());
}

void write_c3d(const C3dFile& content, std::ostream& out, C3dProcessor processor,
               C3dStorage storage) {
  const std::string bytes = Writer(content, processor, storage).write();
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

}  // namespace secondskin
