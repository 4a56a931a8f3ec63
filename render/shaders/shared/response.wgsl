// A camera's response, code to linear signal. The importing shader declares `response`, the linear signal of every code.

// Code whose place on the response curve is nearest to y: found by bisection, rounded between neighbours.
fn encode(y: f32) -> u32 {
    if y <= response[0] {
        return 0u;
    }
    if y >= response[255] {
        return 255u;
    }
    var low = 0u;
    var high = 255u;
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if response[middle] <= y {
            low = middle;
        } else {
            high = middle;
        }
    }
    return select(low, high, 2.0 * y >= response[low] + response[high]);
}
