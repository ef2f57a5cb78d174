#include "bus/health.h"

#include <fmt/format.h>
#include <unistd.h>

namespace secondskin::bus {
namespace {

constexpr std::int64_t kPeriod_ns = 1'000'000'000;

std::string instance_name() {
  char host[256] = "";
  ::gethostname(host, sizeof host - 1);
  return fmt::format("{:.40}:{}", host, ::getpid());
}

}  // namespace

HealthReporter::HealthReporter(Participant& participant, std::string_view service)
    : writer_(participant), since_ns_(now_ns()) {
  message_.service(std::string(service));
  message_.instance(instance_name());
  message_.state(msg::SERVICE_STARTING);
  message_.confidence(1.0);
}

void HealthReporter::sample(double latency) noexcept {
  message_.samples(message_.samples() + 1);
  this_second_.add(latency);
  total_.add(latency);
}

void HealthReporter::state(msg::ServiceState state, std::string_view words) {
  const std::string text(words.substr(0, 256));
  if (state == message_.state() && message_.message() == text) return;
  message_.state(state);
  message_.message(text);
  publish(now_ns());
}

std::int64_t HealthReporter::tick(std::int64_t now_ns) noexcept {
  if (now_ns >= since_ns_ + kPeriod_ns) publish(now_ns);
  return since_ns_ + kPeriod_ns;
}

void HealthReporter::publish(std::int64_t now_ns) noexcept {
  const double seconds = static_cast<double>(now_ns - since_ns_) * 1e-9;
  message_.rate_hz(seconds > 0.0 ? static_cast<double>(this_second_.count()) / seconds : 0.0);
  message_.latency_p50(this_second_.quantile(0.50));
  message_.latency_p99(this_second_.quantile(0.99));
  message_.publish_ns(now_ns);
  writer_.write(message_);
  this_second_.clear();
  since_ns_ = now_ns;
}

}  // namespace secondskin::bus
