//! The statement of a query: its tables, and the order of its rows.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use anyhow::Result;
use re4_fault::{bail, fault};
use sqlparser::ast::{
    CastKind, DataType, Expr, GroupByExpr, ObjectName, OrderBy, OrderByExpr, OrderByKind, OrderByOptions, Query,
    SetExpr, Statement as Parsed, TableFactor, Value, Visit as _, Visitor, visit_expressions_mut,
};
use sqlparser::dialect::GenericDialect;
use sqlparser::parser::{Parser, ParserOptions};

/// A parsed `SELECT` statement.
#[derive(Debug)]
pub(crate) struct Statement {
    query: Box<Query>,
    /// Names of the tables that it reads.
    pub(crate) tables: BTreeSet<String>,
    /// Names that its `WITH` clauses define.
    pub(crate) defined: BTreeSet<String>,
}

impl Statement {
    /// Parses one statement, in the dialect of the engine.
    ///
    /// # Errors
    /// If the text is not one `SELECT` statement.
    pub(crate) fn parse(text: &str) -> Result<Self> {
        let options = ParserOptions {
            trailing_commas: true,
            ..ParserOptions::default()
        };
        let parsed = Parser::new(&GenericDialect)
            .with_options(options)
            .try_with_sql(text)
            .and_then(|mut parser| parser.parse_statements())
            .map_err(|error| {
                let reason = error.to_string();
                let reason = reason.trim_start_matches("sql parser error: ").replace("Expected: ", "expected ");
                fault!("the query is not valid SQL: {reason}"; "correct the query, as in \"select * from results limit 5\"")
            })?;
        let mut parsed = parsed.into_iter();
        let mut query = match (parsed.next(), parsed.next()) {
            (Some(Parsed::Query(query)), None) => query,
            (None, _) => bail!("the query is empty"; "give a SELECT statement"),
            (Some(_), None) => bail!("the query is not a SELECT statement"; "give one SELECT statement"),
            (Some(_), Some(_)) => bail!("the query has several statements"; "give one SELECT statement"),
        };
        let _ = visit_expressions_mut(&mut query, |expression| {
            if is_count(expression) {
                let counted = std::mem::replace(expression, Expr::value(Value::Null));
                *expression = Expr::Cast {
                    kind: CastKind::Cast,
                    expr: Box::new(counted),
                    data_type: DataType::BigInt(None),
                    array: false,
                    format: None,
                };
            }
            ControlFlow::<()>::Continue(())
        });
        let mut found = Names::default();
        let _ = query.visit(&mut found);
        if let Some(function) = found.function {
            bail!("the query reads from {function}, which is not a table of an artifact"; "use the tables of the artifacts");
        }
        let tables = found.relations.difference(&found.defined).cloned().collect();
        Ok(Self {
            query,
            tables,
            defined: found.defined,
        })
    }

    /// The text of the query, in which counts are signed: the engine counts in unsigned integers, whose differences would wrap around.
    pub(crate) fn text(&self) -> String {
        self.query.to_string()
    }

    /// The text of the query with an order that leaves no freedom: rows that are equal in its own `ORDER BY` are ordered by the
    /// output columns with these numbers, counted from 1, and names. `None` if its order is already defined, because it only filters and computes
    /// the rows of one table.
    pub(crate) fn ordered(&self, columns: &[(usize, &str)]) -> Option<String> {
        let mut query = self.query.clone();
        let mut order = match query.order_by.take() {
            None if is_row_by_row(&query) => return None,
            None => Vec::new(),
            Some(OrderBy {
                kind: OrderByKind::Expressions(expressions),
                interpolate: None,
            }) if !expressions.iter().any(is_all) => expressions,
            Some(_) => return None,
        };
        // The engine does not sort by a column twice.
        let named: Vec<String> = order.iter().filter_map(|key| name_of(&key.expr)).collect();
        let others = columns
            .iter()
            .filter(|(_, name)| !named.iter().any(|named| named == name));
        order.extend(others.map(|(number, _)| OrderByExpr {
            expr: Expr::value(Value::Number(number.to_string(), false)),
            options: OrderByOptions::default(),
            with_fill: None,
        }));
        if order.is_empty() {
            return None;
        }
        query.order_by = Some(OrderBy {
            kind: OrderByKind::Expressions(order),
            interpolate: None,
        });
        Some(query.to_string())
    }
}

/// The name of a column that is not computed.
fn name_of(expression: &Expr) -> Option<String> {
    match expression {
        Expr::Identifier(name) => Some(name.value.clone()),
        Expr::CompoundIdentifier(parts) => parts.last().map(|name| name.value.clone()),
        _ => None,
    }
}

/// `COUNT(...)`, also with `OVER`.
fn is_count(expression: &Expr) -> bool {
    matches!(expression, Expr::Function(function) if function.name.to_string().eq_ignore_ascii_case("count"))
}

/// `ORDER BY ALL`, which the engine also accepts as the name of a column.
fn is_all(order: &OrderByExpr) -> bool {
    matches!(&order.expr, Expr::Identifier(name) if name.value.eq_ignore_ascii_case("all"))
}

/// Whether every row of the answer comes from one row of one table, so that the order of the table is that of the answer.
fn is_row_by_row(query: &Query) -> bool {
    let SetExpr::Select(select) = query.body.as_ref() else {
        return false;
    };
    let grouped = match &select.group_by {
        GroupByExpr::All(_) => true,
        GroupByExpr::Expressions(keys, _) => !keys.is_empty(),
    };
    let single = match select.from.as_slice() {
        [] => true,
        [from] => from.joins.is_empty() && matches!(from.relation, TableFactor::Table { .. }),
        _ => false,
    };
    query.with.is_none() && single && !grouped && select.distinct.is_none()
}

/// Collects the names in a query.
#[derive(Default)]
struct Names {
    relations: BTreeSet<String>,
    defined: BTreeSet<String>,
    function: Option<String>,
}

impl Visitor for Names {
    type Break = ();

    fn pre_visit_query(&mut self, query: &Query) -> ControlFlow<()> {
        for defined in query.with.iter().flat_map(|with| &with.cte_tables) {
            self.defined.insert(defined.alias.name.value.clone());
        }
        ControlFlow::Continue(())
    }

    fn pre_visit_relation(&mut self, name: &ObjectName) -> ControlFlow<()> {
        let parts: Vec<String> = name
            .0
            .iter()
            .map(|part| {
                part.as_ident()
                    .map_or_else(|| part.to_string(), |ident| ident.value.clone())
            })
            .collect();
        self.relations.insert(parts.join("."));
        ControlFlow::Continue(())
    }

    fn pre_visit_table_factor(&mut self, factor: &TableFactor) -> ControlFlow<()> {
        match factor {
            TableFactor::Table {
                name, args: Some(_), ..
            }
            | TableFactor::Function { name, .. } => {
                self.function = Some(format!("{name}(...)"));
            }
            TableFactor::TableFunction { expr, .. } => self.function = Some(expr.to_string()),
            _ => {}
        }
        ControlFlow::Continue(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Statement {
        Statement::parse(text).unwrap()
    }

    fn refused(text: &str) -> String {
        Statement::parse(text).unwrap_err().to_string()
    }

    #[test]
    fn tables_of_all_parts_of_a_query_are_found() {
        let names = |text: &str| parsed(text).tables.into_iter().collect::<Vec<_>>().join(" ");
        assert_eq!(names("select * from results"), "results");
        assert_eq!(names("select 1"), "");
        assert_eq!(
            names("select * from a join b using (x) left join \"c d\" on b.y = \"c d\".y"),
            "a b c d"
        );
        assert_eq!(
            names("select * from (select x from a) s where x in (select x from b)"),
            "a b"
        );
        assert_eq!(
            names("with w as (select * from a) select * from w union all select * from b"),
            "a b"
        );
        assert_eq!(names("select * from s.a"), "s.a");
    }

    #[test]
    fn only_one_select_of_tables_is_accepted() {
        assert_eq!(refused(""), "the query is empty");
        assert_eq!(refused("drop table a"), "the query is not a SELECT statement");
        assert_eq!(refused("select 1; select 2"), "the query has several statements");
        assert!(refused("select * from").starts_with("the query is not valid SQL: "));
        assert!(refused("select * from read_parquet('x')").contains("read_parquet(...)"));
        assert!(refused("select * from a where (").starts_with("the query is not valid SQL: "));
    }

    #[test]
    fn an_order_is_added_where_the_query_leaves_it_open() {
        let ordered = |text: &str| parsed(text).ordered(&[(1, "a"), (3, "c")]);
        assert_eq!(ordered("select a, b, c from t where a > 1 limit 3"), None);
        assert_eq!(ordered("select * from t order by all"), None);
        for (text, expected) in [
            (
                "SELECT a FROM t ORDER BY b DESC",
                "SELECT a FROM t ORDER BY b DESC, 1, 3",
            ),
            ("SELECT a FROM t ORDER BY a DESC", "SELECT a FROM t ORDER BY a DESC, 3"),
            ("SELECT a FROM t GROUP BY a", "SELECT a FROM t GROUP BY a ORDER BY 1, 3"),
            (
                "SELECT DISTINCT a FROM t LIMIT 2",
                "SELECT DISTINCT a FROM t ORDER BY 1, 3 LIMIT 2",
            ),
            (
                "SELECT a FROM t JOIN u USING(a)",
                "SELECT a FROM t JOIN u USING(a) ORDER BY 1, 3",
            ),
            (
                "SELECT a FROM t UNION ALL SELECT a FROM u",
                "SELECT a FROM t UNION ALL SELECT a FROM u ORDER BY 1, 3",
            ),
        ] {
            assert_eq!(ordered(text).as_deref(), Some(expected));
        }
    }
}
