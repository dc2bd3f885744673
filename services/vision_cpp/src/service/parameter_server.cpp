#include "service/parameter_server.hpp"

#include <chrono>
#include <functional>
#include <utility>

#include "service/codec.hpp"
#include "service/health.hpp"
#include "service/keys.hpp"

namespace armsight::vision::service {
namespace {

constexpr const char* kName = "vision";
constexpr std::chrono::milliseconds kPoll{500};  // how soon a stop is seen

// One question after the other, until the session or the thread ends.
void answer_each(const zenoh::Queryable& queryable, const std::stop_token& stop,
                 const std::function<void(const zenoh::Query&)>& answer) {
    while (!stop.stop_requested()) {
        try {
            if (const auto query = queryable.recv(kPoll)) answer(*query);
        } catch (const zenoh::ZException&) {
            return;  // the session is closed
        }
    }
}

}  // namespace

ParameterServer::ParameterServer(const zenoh::Session& session, Tunables start, std::string configuration,
                                 Counters& counters)
    : configuration_(std::move(configuration)),
      counters_(counters),
      parameters_(std::move(start)),
      told_(session.declare_publisher(key_for(topics::kParameters.key, kName), topics::kParameters.encoding,
                                      options_of(topics::kParameters))),
      asked_(session.declare_queryable(key_for(topics::kParametersQuery.key, kName))),
      set_(session.declare_queryable(key_for(topics::kSetParametersQuery.key, kName))) {
    tell();
    asked_thread_ = std::jthread([this](const std::stop_token& stop) {
        answer_each(asked_, stop, [this](const zenoh::Query& query) { answer(query); });
    });
    set_thread_ = std::jthread([this](const std::stop_token& stop) {
        answer_each(set_, stop, [this](const zenoh::Query& query) { take(query); });
    });
}

void ParameterServer::tell() {
    told_.put(zenoh::as_bytes(encode_parameters(wall_ns(), parameters_.messages()).SerializeAsString()));
}

void ParameterServer::answer(const zenoh::Query& query) const {
    v1::ParametersResponse response;
    response.set_json(configuration_);
    for (const auto& parameter : parameters_.messages()) *response.add_parameters() = parameter;
    query.reply(zenoh::as_bytes(response.SerializeAsString()), topics::kSetParametersQuery.response_encoding);
}

void ParameterServer::take(const zenoh::Query& query) {
    try {
        if (parameters_.set(decode_set_parameters(query.get_payload()))) tell();
    } catch (const MalformedMessage& error) {
        counters_.add("malformed_set_parameters");
        query.reply_err(error.what());
        return;
    } catch (const ParameterError& error) {
        counters_.add("refused_set_parameters");
        query.reply_err(error.what());
        return;
    }
    answer(query);
}

}  // namespace armsight::vision::service
