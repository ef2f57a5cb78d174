#include "clients/dashboard/orders.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <vector>

#include "bus/topics.h"

namespace secondskin::dashboard {
namespace {

namespace msg = bus::msg;
using Json = nlohmann::json;

// As the command line has them.
constexpr double kSmallestScale = 0.1, kLargestScale = 10.0;
constexpr std::uint32_t kMostCues = 16;
constexpr std::array<std::string_view, 4> kActions{"start", "pause", "resume", "stop"};

struct Refusal : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// An order's fields; refuses those that it does not know.
class Fields {
 public:
  Fields(std::span<const std::uint8_t> payload, std::vector<std::string_view> known)
      : json_(Json::parse(payload.begin(), payload.end(), nullptr, false)) {
    if (!json_.is_object()) {
      throw Refusal(fmt::format("expected a JSON object with {}", fmt::join(known, ", ")));
    }
    for (const auto& [name, value] : json_.items()) {
      if (std::find(known.begin(), known.end(), name) == known.end()) {
        throw Refusal(
            fmt::format("field '{:.40}': expected one of {}", name, fmt::join(known, ", ")));
      }
    }
  }

  std::string text(const char* field, std::size_t longest) const {
    const auto found = json_.find(field);
    if (found == json_.end()) return {};
    if (!found->is_string() || found->get_ref<const std::string&>().size() > longest) {
      throw Refusal(fmt::format("field '{}': expected a text of at most {} bytes", field, longest));
    }
    return found->get<std::string>();
  }
  const Json* find(const char* field) const {
    const auto found = json_.find(field);
    return found == json_.end() ? nullptr : &*found;
  }

 private:
  Json json_;
};

msg::SessionCommand session_from_json(std::span<const std::uint8_t> payload) {
  const Fields fields(payload,
                      {"action", "reference", "tolerance_scale", "max_cues", "plan", "learner"});
  msg::SessionCommand order;
  const std::string action = fields.text("action", 16);
  const auto* found = std::find(kActions.begin(), kActions.end(), action);
  if (found == kActions.end()) {
    throw Refusal(fmt::format("field 'action': expected {}", fmt::join(kActions, ", ")));
  }
  order.action(static_cast<msg::SessionAction>(found - kActions.begin()));
  order.reference(fields.text("reference", 64));
  order.plan(fields.text("plan", 64));
  order.learner(fields.text("learner", 64));
  if (const Json* scale = fields.find("tolerance_scale")) {
    if (!scale->is_number()) throw Refusal("field 'tolerance_scale': expected a number");
    order.tolerance_scale(scale->get<double>());
  }
  if (const Json* cues = fields.find("max_cues")) {
    if (!cues->is_number_integer() || *cues < 0 || *cues > kMostCues) {
      throw Refusal(fmt::format("field 'max_cues': expected 0 (keep) or 1 to {}", kMostCues));
    }
    order.max_cues(cues->get<std::uint32_t>());
  }
  return order;
}

void check(const msg::SessionCommand& order) {
  const double scale = order.tolerance_scale();
  if (scale != 0.0 && !(scale >= kSmallestScale && scale <= kLargestScale)) {
    throw Refusal(fmt::format("field 'tolerance_scale': expected 0 (keep) or {} to {}",
                              kSmallestScale, kLargestScale));
  }
  if (order.max_cues() > kMostCues) {
    throw Refusal(fmt::format("field 'max_cues': expected 0 (keep) or 1 to {}", kMostCues));
  }
}

template <class Message>
Message from_cdr(std::span<const std::uint8_t> payload, const char* type) {
  Message message;
  if (!bus::decode(payload, message)) {
    throw Refusal(fmt::format("expected a whole {} in CDR with its encapsulation header", type));
  }
  return message;
}

}  // namespace

tl::expected<msg::SessionCommand, std::string> session_command(
    std::string_view encoding, std::span<const std::uint8_t> payload) {
  try {
    auto order = encoding == "cdr" ? from_cdr<msg::SessionCommand>(payload, "SessionCommand")
                                   : session_from_json(payload);
    check(order);
    return order;
  } catch (const Refusal& refusal) {
    return tl::unexpected(std::string(refusal.what()));
  }
}

tl::expected<msg::EmergencyStop, std::string> emergency_stop(
    std::string_view encoding, std::span<const std::uint8_t> payload) {
  try {
    if (encoding == "cdr") return from_cdr<msg::EmergencyStop>(payload, "EmergencyStop");
    const Fields fields(payload, {"active", "reason"});
    const Json* active = fields.find("active");
    if (active == nullptr || !active->is_boolean()) {
      throw Refusal("field 'active': expected true or false");
    }
    msg::EmergencyStop stop;
    stop.active(active->get<bool>());
    stop.reason(fields.text("reason", 128));
    return stop;
  } catch (const Refusal& refusal) {
    return tl::unexpected(std::string(refusal.what()));
  }
}

}  // namespace secondskin::dashboard
